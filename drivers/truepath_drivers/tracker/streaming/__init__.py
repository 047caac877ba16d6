"""The streaming tracker: GST/1 frames over serial or TCP (docs/tracker-protocol.md).

`framing` cuts and checks frames, `messages` and `measurements` define their content,
`message_codec` the bytes of messages, `codec` turns bytes into samples with unwrapped
counters, `receiver` is the thread that reads the port, `command_link` sends commands
and awaits their replies, `driver` is the device.

Simulators use the first four from the other end of the wire.
"""
