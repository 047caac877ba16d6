"""Doing it: recording a Run while the machine moves, and carrying Runs in and out.

A cell process (`cell`, `cell_process`) owns the devices and runs one `Measurement` at a
time: `on_the_fly` streams a path that the controller drives by itself, `step_through`
stands at points. Both are made of the steps of `session`; all their waiting is the
`tick` of `watch`, which feeds the controller's watchdog, so an engine that hangs holds
the feed.

Time is the tracker's counter. Tracker and controller share no clock and none is
assumed (sanders-2023): a Run begins and ends with the stream at a standstill, and the
sequence of lines says which is which. Controller positions are kept for health, never
paired with samples.

Raw batches are on disk before anything looks at them (`recorder`), so a Run survives
the death of its process; `recording` opens whatever was committed. `bundle` reads and
writes the exchange form. The pure record that science sees is `run`; it knows no file.

docs/measurement.md lists processes, threads, events and the layout of the Run file.
"""
