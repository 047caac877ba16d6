"""Thermometers and sensors of the air, one folder a kind of link.

Not here: what readings may be believed, which the service decides.
"""
