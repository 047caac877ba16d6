"""Measurement: motion of the machine, recording of the tracker, a Run on disk.

Here: all that runs in the cell process, up to the closed Run. Not here: its supervisor
(`machines`), drivers (`truepath_drivers`), the meaning of samples (`alignment`).

A cell process (`cell`, `cell_process`) owns the devices and runs one `Measurement` at a
time. There are two ways to measure: the controller executes a path (`path_steps`) while
the tracker streams, or the machine is at rest. All waiting is the `tick` of
`measurement_monitor`, which feeds the controller's watchdog: if the engine hangs, the
machine holds. Requests to the tracker are in `tracker_control`.

Path of a sample: the driver decodes it; `stream_reader` collects blocks of 20 ms into
batches of 100 ms; `recorder` commits a batch to the Run's SQLite file (`run_file`)
before anything else sees it; then it goes to the display and to the live estimate. A
Run therefore survives the death of its process: `run_loader` opens what was committed.

Time is the tracker's counter. Tracker and controller share no clock and none is assumed
(sanders-2023): a Run begins and ends with the stream at a standstill, and the sequence
of lines shows which line is which. Controller positions are recorded for health and are
never paired with samples.

Commands to the cell and events from it are the records of `messages`.
docs/measurement.md lists processes, threads, events and the layout of the Run file.
"""
