"""From one Run to observations: which samples belong to which commanded line.

Here: what is found by geometry in one Run. Not here: the noise of observations and the
errors of the machine (`estimation`), the file of the Run (`measurement`, `files`).

No clock is shared between controller and tracker, so the geometry has to tell. Where
the target stands still is found by its speed (`stops`). Distances
between standstills do not depend on where the tracker stands: the longest chain of
standstills whose distances agree with the commanded places gives the sequence of lines
and, by a rigid fit, the rough pose of the tracker (`sequence`; Umeyama 1991).

Each line is then cut out at its steady feed (`segmentation`); on a line on which rotary
axes turn, the target follows a curve (`nominal_path`). Samples near changes of
direction are left out. Samples are reduced to cells: means over short stretches of time
or travel that carry all that their samples tell of smooth errors (`reduction`,
`cell_blocks`). Phase and speed of a line are estimated again later; here they only
assign positions of the axes to cells, along the path (sanders-2023 takes deviations
across the path alone, which no error of timing reaches).

`align` does this for a closed Run, `streaming` while samples come; both give the same
cells. `observations` adds what effects depend on besides positions: rates, the distance
since a reversal, temperatures. Gates refuse what cannot be aligned with a clear message
(`cleaning`).
"""
