"""The machine: its chain of axes and the ISO symbols of their errors.

Here: nominal geometry. Not here: what moves the point off it (`kinematics.effects`),
`machine.json` (`files.bundle`).
"""
