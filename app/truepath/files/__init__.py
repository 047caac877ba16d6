"""The border: files of measurements and recordings, parsed and checked here.

Here: files that come from users, and results of an earlier analysis for a later one.
Not here: files that an answer writes (`results`, `answers`, `compensation`), the SQLite
file of a Run (`measurement.run_file`), how files are written atomically (`documents`).

Formats: the measurement bundle (`bundle`, a folder or a .zip) with machine, path or
points, tracker stream, environment and reference; the workspace of a plan; result and
model files. A `Run` is the content of a bundle or a recording; analysis begins with it.

Conventions

    Files state mm, deg, s and °C, errors in µm and µrad; the suffix of a key or column
    names its unit. Inside are mm, rad, s, °C (`units` converts).

    Error symbols are those of ISO 230-1. Paths and points are axis positions; the
    nominal tool point is the axis position plus the tool offset.

    A rigid motion of the whole volume is no machine error. Positioning and angular
    errors are 0 at the axis zero, else at the lowest position; straightness is 0 at
    both ends, its slope being stated as squareness.

JSON files are pydantic models (`documents.file_model`): unknown keys are ignored, null
is missing, numbers are finite and neither texts nor truth values. CSV and Parquet
tables are read by columns (`tables`). An error is one BundleError in one line:
`machine.json: axes.X.max_mm is true; write a number`, or `path.csv, row 4, column y_mm:
is 'abc', not a number`.

Files are written completely or not at all (`documents.whole_files`). Archives are read
in memory, member by member, each up to a limit.

References: ISO 230-1:2012 (symbols), ISO 10791-6 (kinematic chain).
"""
