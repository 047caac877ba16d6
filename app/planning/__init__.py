"""Where to measure, in which order, and whether the machine may go there.

One criterion for all: the integrated variance J = tr(G C) of the volumetric error
(Brunn & Hanebeck 2005, eq. 24–26, 34–36), lowered as much as possible for the time it
takes. What is believed of the machine (`outlook`) is handed in from the estimator, so
that a plan is judged as its measurement will be.

    next_configuration   the paper's own question: the best place to measure next
    outlook              what is known, and what a leg would tell; of lines, of points
    leg_choice           stops whose legs tell most per second: greedy, then exchange
    planner              a plan within a time, from where the machine is, within limits
    workspace, travel    keep-out boxes, range and line of sight; the travel
    motion_times         how long motions take, what of a line is steady
    corner_path          the path of the 2023 paper, to compare with
    paths                paths and points without a plan
    nc_programs          a plan as a control's program, and back
"""
