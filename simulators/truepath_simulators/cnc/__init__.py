"""A controller behind Modbus, thermometers beside it, and the process that is both.

Not here: how it moves (`motion`), what it makes of tables (`compensation`).
"""
