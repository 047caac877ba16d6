"""LinuxCNC over linuxcncrsh, with a watchdog in HAL (docs/linuxcnc.md).

links      linuxcncrsh, and beats to `truepath_watchdog.py`, loaded by `truepath.hal`
machine    axes and travel, from the INI file or from an option
program    a path as a program, and its lines as rows
session    a connected LinuxCNC, used by one thread at a time, and its readings
driver     the verbs of a motion controller, and one motion from begin to end
"""
