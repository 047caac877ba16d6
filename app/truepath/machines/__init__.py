"""A machine's cell as the service sees it: started, supervised, asked, connected.

Here: the cell's supervisor, what it showed last, samples for listeners. Not here: the
cell process itself (`measurement.process`), rows of machines (`catalogue`).
"""
