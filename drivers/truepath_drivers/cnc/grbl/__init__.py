"""Controllers that speak GRBL 1.1 on a serial line.

`protocol` has its words and a path as short lines, `session` the line both ways,
`motion` the progress of a motion, `driver` the verbs.
"""
