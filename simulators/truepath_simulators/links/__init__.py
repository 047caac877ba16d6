"""Serial, TCP and UDP ends of the wire, and what damages what passes through them."""
