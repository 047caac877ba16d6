"""Thermometers and sensors of the air, one folder a kind of link."""
