"""LinuxCNC over linuxcncrsh, with a watchdog in HAL (docs/linuxcnc.md).

rsh                one connection to linuxcncrsh
machine            axes and travel, from the INI file or from an option
program            a path as a program, and its lines as rows
watchdog           beats to `truepath_watchdog.py`, loaded by `truepath.hal`
motion             a motion from begin to end, what is watched and remembered of it
session            a LinuxCNC that is connected, asked one thread at a time
readings           what linuxcncrsh says of the machine, as states
driver             the verbs of a motion controller
"""
