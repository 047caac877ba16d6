"""A recorded Run played back as devices.

Not here: recordings made without devices (`worlds`).
"""
