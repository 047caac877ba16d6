"""The streaming tracker: GST/1 frames over serial or TCP (docs/tracker-protocol.md).

`framing` cuts and checks frames, `messages` has the rare messages and their bytes,
`codec` turns measurements into samples with unwrapped counters and back, `link` is the
thread that reads the port and the commands with their replies, `driver` the device.

Simulators use the first three from the other end of the wire.
"""
