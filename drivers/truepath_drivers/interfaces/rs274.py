"""Straight lines to machine positions in LinuxCNC's G-code (RS-274/NGC).

For drivers that send it and for the service, which writes whole programs.

`G53` holds in its block: positions are machine coordinates whatever offsets are set.
The exact stop is `G61.1`: `G61` follows the path exactly but runs through rows that lie
on one line (measured on LinuxCNC 2.9). F is the feed of X, Y, Z where one of them
moves, else that of the rotary axes, in deg/min. An arc is incremental, end and centre
(`G91 G91.1`), since `G53` takes no arcs: so it depends on no offset either, unless
coordinates are rotated (`G10 L2 R`).

Source: LinuxCNC documentation, G-code reference (G53, G61.1, G94), and its interpreter.
"""

SAFE_START = ("G21", "G17 G40 G49 G80 G90 G94", "G61.1")
MOTION = "G53 G1 {ends} F{row.feed:.3f}"
ARC = "{plane} G91 G91.1 {verb} {ends} {centre} P{turns} F{row.feed:.3f}"
AFTER_ARC = "G90 G17"
DWELL = "G4 P{:.3f}"
END = "M2"
DECIMALS = 4
