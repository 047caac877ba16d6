"""What the machine may be commanded to do, and how long it takes.

A command is a `Path`, executed through its rows without a stop of the recording, or
`Configurations`, standstill points. Rows are axis positions in mm and deg, lines are
straight in them: all axes start and stop together, so a line never leaves a box that
holds both of its ends, and checking the rows checks the whole swept path. A line goes
from rest to rest within the machine's acceleration a and jerk j. The ramp to a speed v
takes t = v / a + a / j (2 √(v / j) below v = a² / j) over a length of v t / 2, so a
line of length l takes l / v + t; v is the feed or, on a short line, the speed at which
v t = l. The length is that of the linear axes; where none moves it is in deg, and so is
the feed.

    configurations     standstill points; commanded rows
    workspace          inside the axes' ends, with a margin; keep-out boxes by slabs;
                       range and sight of the tracker over the triangle that the beam
                       sweeps (Akenine-Möller 2001)
    motion_times       how long motions take, which part of a line has constant feed;
                       stops in an order of short moves (2-opt: Croes 1958)
    paths              rows of users, checked; points and lines without a plan; circles;
                       the path of sanders-2023 (`corner_path`), for comparison
    nc_programs        a plan as a control's program, and back

Nothing here depends on uncertainty: what is worth measuring is decided in `planning`;
`workspace.json` is a file of `files.bundle`.
"""
