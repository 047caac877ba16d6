"""Sensors behind Modbus TCP or RTU, by a list of registers."""
