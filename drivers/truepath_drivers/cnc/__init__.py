"""Machine controllers, one folder a make.

Not here: ports (`transport`), compensation files and NC programs, which the service
writes.
"""
