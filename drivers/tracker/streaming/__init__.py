"""The streaming tracker: GST/1 frames over serial or TCP (docs/tracker-protocol.md).

`framing` cuts and checks frames, `messages` and `measurements` say what they mean,
`codec` is the way from bytes to samples with whole counters, `receiver` the thread that
reads the port, `driver` the device. Simulators use the first three from the other end
of the wire.
"""
