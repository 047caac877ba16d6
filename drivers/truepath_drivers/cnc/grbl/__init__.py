"""Controllers that speak GRBL 1.1 on a serial line.

`protocol` has its words, `program` a path as pieces, `stream` their count of bytes,
`session` the line, `driver` the verbs.
"""
