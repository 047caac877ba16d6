"""Where to put the tracker, and what a further station would add.

Not here: the job that leads from one to the next (`jobs.kinds.station_steps`).
"""
