"""The cell: the process that owns the devices, and its messages to the service.

Not here: its supervisor on the other side (`machines.cell_supervisor`).
"""
