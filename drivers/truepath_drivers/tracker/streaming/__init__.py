"""The streaming tracker: GST/1 frames over serial or TCP (docs/tracker-protocol.md).

`framing` cuts and checks frames, `messages` and `measurements` say what they mean,
`message_codec` how messages are written, `codec` is the way from bytes to samples with
whole counters, `receiver` the thread that reads the port, `command_link` sends commands
and awaits their replies, `driver` is the device.
Simulators use the first four from the other end of the wire.
"""
