"""The device end of the wire: a truth machine, a tracker, a CNC and their faults.

Written independently of the service, so that a bench cannot confirm the estimator's own
mistakes: the truth machine composes exact homogeneous transforms,

    p = T_1(s_1) ... T_n(s_n) t,    T_i(s) = Trans(s d_i) Trans(E_i(s)) R(omega_i(s)),

over the axes from workpiece to tool. `t` is the tool offset, `d_i` the direction of
travel (out of square by the squareness), `E_i` and `omega_i` the error motions, all of
the tool relative to the workpiece. To first order this is the linear form of the file
formats; the rest is what a linear estimator does not know. A rotary axis turns instead
of travelling, about an axis that is not quite where it should be.

Two processes share one motion. The CNC process plans it as pieces of cubic polynomials
(straight lines, exact stops, limited jerk) and publishes them on a board of shared
memory; the tracker process evaluates them at its own sample times. Positions follow in
closed form from seed and time alone, at any speed of the clock.

    machine_file    the nominal machine, as machine.json states it
    error_motions   random smooth error motions; turning_motions: of rotary axes
    rotary_joint    a rotary axis, its location and error motions
    truth_machine   where the tool really is
    random_machine  machines that err, drawn
    profile         feed along one line with limited acceleration and jerk
    program         waypoints, as a CNC is given them
    timeline        a whole motion, piece by piece
    driven_motion   the motion along a line or through a program; reversals: its arcs
    interruption    hold, resume, override
    tracker_head    range and angles of a point, with noise correlated in time
    paths           paths and points without a planner; turning_paths: with rotary axes
    synthetic       whole recordings without wire and without waiting
    hidden          effects that no rigid-body model knows, one physical cause a file
    scale_sensors   temperatures of the axis scales
    faults          what goes wrong, when
    tracker_*       the tracker behind its wire
    cnc_*, modbus_* the CNC behind its wire
    thermometer_gateway  sensors of machine and air on Modbus, in the process of the CNC
    bench, command  both processes together, for tests and for test rigs
    replay*         devices that repeat a recorded Run
    control_*, rig  a rig worked from outside; pytest_plugin: fixtures on it
"""
