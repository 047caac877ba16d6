"""A machine's cell as the service sees it: started, supervised, queried, connected.

Here: the cell's supervisor, the last state, samples for listeners. Not here: the cell
process itself (`measurement.process`), rows of machines (`catalogue`).
"""
