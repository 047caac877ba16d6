"""A controller behind Modbus, and the process that is one."""
