"""A measuring path as a program that an operator loads into a control by hand.

Here: programs that move the machine. Compensation files are in `compensation.formats`.

A calibration needs a control only for the motion along the path: straight lines at a
steady feed, an exact stop and a dwell at each row, in machine coordinates. Every
control that reads a program can therefore be measured without a link to it: the
tracker's stream alone shows when each line was executed.

Three rules make a path and its program the same motion:

- positions are coordinates of the machine, never of a workpiece: frames are suppressed
in each block (`SUPA`, `M91`, `G53`), or the control itself checks that they are zero
(Fanuc), and tool length and radius are not applied;
- each row is an exact stop. `G61` of LinuxCNC and a Heidenhain block without a dwell
run through collinear rows, so they are not used for that;
- each program is read back by a separate reader, which knows the rules of the control
and shares nothing with the writer, and is compared with path and travel.

    programs              a path or points to a text and back: header and rows, rounded
                          as they are printed; the checks
    programmed_motion     a control that runs a program, and its motion row by row
    dialect               the interface of a control's format: its content, the order of
                          its blocks
    gcode                 words, modal groups and motions of G-code; LinuxCNC
    siemens, heidenhain, fanuc     one control a file

Third parties add controls in the entry-point group `truepath.nc_dialects`.
"""
