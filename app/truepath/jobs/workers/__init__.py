"""Local or Dask processes that compute, and their tasks.

Here: files of Runs in, files of a result out. Not here: any science: tasks call
`results`, `planning` and `answers`.
"""
