"""A CNC or PLC gateway behind Modbus TCP or RTU (docs/modbus-register-map.md)."""
