"""How a controller moves: programs, profiles, driven and interrupted motion.

Here also: paths without a planner. Not here: registers and commands (`cnc`).
"""
