"""Controllers that speak GRBL 1.1 on a serial line.

`protocol` has its words, `program` a path as short lines, `session` the line both ways,
`motion` what a motion has come to, `driver` the verbs.
"""
