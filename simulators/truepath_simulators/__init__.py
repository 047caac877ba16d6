"""The device end of the wire: a truth machine, a tracker, a CNC and their faults.

Written independently of the service, so that a bench cannot confirm the estimator's own
mistakes: the truth machine composes exact homogeneous transforms,

    p = T_1(s_1) ... T_n(s_n) t,    T_i(s) = Trans(s d_i) Trans(E_i(s)) R(omega_i(s)),

over the axes from workpiece to tool. `t` is the tool offset, `d_i` the direction of
travel (out of square by the squareness), `E_i` and `omega_i` the error motions, all of
the tool relative to the workpiece. To first order this is the linear form of the file
formats; the rest is what a linear estimator does not know. A rotary axis turns instead
of travelling, about an axis with location errors.

Two processes share one motion. The CNC process plans it as pieces of cubic polynomials
(straight lines, exact stops, limited jerk) and publishes them on a board of shared
memory; the tracker process evaluates them at its own sample times. Positions follow in
closed form from seed and time alone, at any speed of the clock.

    machine         joints with error motions, composed exactly; random machines
    motion          feed, acceleration, jerk; programs, holds, paths without a planner
    hidden          effects that no rigid-body model knows, one physical cause a class
    tracker, cnc    the devices behind their wires; sensors of machine and air
    links           the wires, and what damages what passes through them
    compensation    what a control makes of compensation files
    bench           all of it together, for tests and for test rigs
    worlds          whole recordings without wire and without waiting
    replay          devices that repeat a recorded Run
    linuxcnc        a real LinuxCNC, started for tests
    scenarios       machines by name, in the form of `machine.json`

Single files here (`timeline`, `processes`, `faults`, …) are shared by these.
Not here: anything that the service imports.
"""
