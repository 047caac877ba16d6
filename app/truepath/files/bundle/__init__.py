"""The measurement bundle and its content: machine, path, stream, workspace, Run.

Here: files of one measurement, read and written. Not here: recordings of other software
(`files.imports`), the Run while it is recorded (`measurement.run_file`).
"""
