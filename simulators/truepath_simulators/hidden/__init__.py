"""Effects outside of a rigid-body model: one physical cause per class.

An effect moves the target in one of four places: it adds to the error motions of a
joint (`added_error_motions`), shifts the target of the tracker (`common_shift_mm`),
falsifies a reading of the tracker (`reading_error`), or warms a sensor
(`warming_degc`). Each is written from its physics: lost motion is a play operator with
its own memory, a servo is a first-order lag of the motion that the controller really
commands, a screw turns, a circle is off its axis. Its `truth` has the form of
`discovery.json`, so that a service's findings can be compared with it.

    motion            past motion of the axes, exactly, at any time
    effect            what an effect answers; all effects together
    effects_by_name   effects at random, by seed; as text, for other processes
    drives, structure, setup   the effects, by the part that causes them

Play operator: M. Brokate and J. Sprekels, Hysteresis and Phase Transitions, 1996.
"""
