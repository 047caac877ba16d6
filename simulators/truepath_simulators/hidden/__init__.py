"""What a rigid-body model does not know: one physical cause a class.

An effect moves the target in one of four places: it adds to the error motions of a
joint (`carry`), shifts what the tracker looks at (`shift_mm`), spoils a reading of
the tracker (`misread`), or warms a sensor (`warming_degc`). Each is written from its
physics: lost motion is a play operator with its own memory, a servo is a first-order
lag of the motion that the controller really commands, a screw turns, a circle is off
its axis. Its `truth` is in the words of `discovery.json`, so that what a service says
can be compared with what was hidden.

    motion          what the axes have done so far, exactly, at any time
    effect          what an effect answers
    superposition   all effects together, as the tracker sees them
    drawing         effects at random, by seed; as text, for other processes

Play operator: M. Brokate and J. Sprekels, Hysteresis and Phase Transitions, 1996.
"""
