"""Model of the machine: axes, nominal chain, and effects that move the measured point.

Here: geometry and physical causes. Not here: values from measurements (`estimation`),
travel and motion in time (`motion`), `machine.json` (`files.bundle`).

A machine is a serial chain from the workpiece over the base to the tool, of linear and
rotary axes in any order on either side (ISO 10791-6: `w-X-b-Y-Z-t`). `chain` follows a
target through it: where the target is nominally, and how an error at an axis shows
where the tracker stands. To first order an error displacement E and an error turn ω at
an axis move the target by F (E + ω × L): L is the lever from the axis to the target, F
the nominal turn of everything between the error and the observer.

Everything that moves the measured point off its nominal is an `Effect`, linear in its
parameters θ: the measured point is nominal + Σ J(conditions) θ. `effects/` holds the
physical causes: the six error motions of an axis as cubic splines over its travel
(brunn-hanebeck-2005, eq. 2-20; ISO 230-1 symbols), squareness, location of rotary axes,
and causes such as backlash, sag, thermal growth, and what belongs to the measurement:
pose, timing, tracker. A `MachineModel` is a machine with effects; θ holds their
parameters one effect after another. Effects answer questions about themselves (role,
table, axis pair, Run); no other room asks for their class. Curves along an axis are
natural or cyclic cubic splines, linear in their control values (`splines`;
brunn-hanebeck-2005, eq. 2–11). Their second derivatives solve a tridiagonal system;
bending energy and Gram matrix are integrals in closed form (eq. 12–13, 24–26).
`volumetric_map` gives the errors in the whole volume without its rigid motion.

Which error motions the measured targets determine is a matter of geometry alone:
`identifiable` finds it for any chain, and names what is confounded. With one tool
offset, 14 of the 18 error motions of three linear axes are identifiable.
"""
