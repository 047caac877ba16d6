"""Whether a machine keeps what its model says: on lengths, at places, as driven.

`places` and `circles` hold what is computed of each.
"""
