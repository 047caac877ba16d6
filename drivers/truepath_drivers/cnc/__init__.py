"""Machine controllers, one folder per make.

Not here: ports (`transport`), compensation files and NC programs, which the service
writes.
"""
