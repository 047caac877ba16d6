"""A controller behind Modbus, thermometers, and the process with both.

Not here: its motion (`motion`), its use of tables (`compensation`).
"""
