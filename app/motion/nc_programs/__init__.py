"""A measuring path as a program that an operator loads into a control by hand.

A calibration needs nothing of the control but that it drives the path: straight lines
at a steady feed, an exact stop and a dwell at each row, all in machine coordinates. So
every control that reads a program can be measured, with no link to it at all; the
tracker's stream alone tells what was driven when.

Three things make a path and its program the same motion:

- positions are coordinates of the machine, never of a workpiece: frames are suppressed
  in each block (`SUPA`, `M91`, `G53`), or their being zero is checked by the control
  itself (Fanuc), and tool length and radius are out of the way;
- each row is an exact stop. `G61` of LinuxCNC and a Heidenhain block without a dwell
  run through collinear rows, so they are not used for that;
- what is written is read back by a reader of its own, which knows the rules of that
  control and shares nothing with the writer, and is held against path and travel.

    programs     a path or points to a text and back; the checks
    order        what is to be commanded, as it will be printed; the header
    dialect      what a control's file promises; found by entry point
    control      a reader's memory: where the axes are, what was seen
    iso_words    words and modal groups of G-code, for readers
    siemens, heidenhain, fanuc, linuxcnc     one control a file

Third parties add controls in the entry-point group `truepath.nc_dialects`.
"""
