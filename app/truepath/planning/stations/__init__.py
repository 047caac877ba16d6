"""Choice of the tracker's station, and the benefit of further stations.

Not here: the job that leads from one to the next (`jobs.kinds.stations`).
"""
