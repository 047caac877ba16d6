"""The database of jobs, Runs and machines, its schema, its file and its lock.

What a job does is `truepath.jobs`; what a Run holds is `measurement.run_file`.
"""
