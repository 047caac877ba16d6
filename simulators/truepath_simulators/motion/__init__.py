"""Motion of a controller: programs, profiles, normal and interrupted motion.

Here also: paths without a planner. Not here: registers and commands (`cnc`).
"""
