"""From one Run to observations: which samples belong to which commanded line.

Here: recognition by geometry in one Run. Not here: the noise of observations and the
errors of the machine (`estimation`), the file of the Run (`measurement`, `files`).

No clock is shared between controller and tracker, so geometry decides. Standstills of
the target are found by its speed (`stops`). Distances between standstills do not depend
on the tracker's position: the longest chain of standstills whose distances agree with
the commanded points gives the sequence of lines and, by a rigid fit, the rough pose of
the tracker (`sequence`; Umeyama 1991).

Each line is then cut out at its steady feed (`segmentation`); on a line on which rotary
axes turn, the target follows a curve (`nominal_path`). Samples near changes of
direction are excluded. Samples are reduced to cells: means over short stretches of time
or travel that contain all the information of their samples on smooth errors
(`reduction`, `cell_blocks`). Phase and speed of a line are estimated again later; here
they only assign positions of the axes to cells, along the path (sanders-2023 uses
deviations across the path alone, which are free of timing errors).

`align` does this for a closed Run, `streaming` while samples come; both give the same
cells. `observations` adds the other conditions that effects depend on: rates, the
distance since a reversal, temperatures. Gates reject data that cannot be aligned with a
clear message (`cleaning`).
"""
