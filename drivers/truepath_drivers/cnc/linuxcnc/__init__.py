"""LinuxCNC over linuxcncrsh, with a watchdog in HAL (docs/linuxcnc.md).

rsh                one connection to linuxcncrsh
machine            axes and travel, from the INI file or from an option
program            a path as a program, and its lines as rows
watchdog           beats to `truepath_watchdog.py`, loaded by `truepath.hal`
motion             one motion from begin to end, and its state
session            a connected LinuxCNC, used by one thread at a time
readings           replies of linuxcncrsh as states of the machine
driver             the verbs of a motion controller
"""
