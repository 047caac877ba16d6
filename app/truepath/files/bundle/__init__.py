"""The measurement bundle and what it holds: machine, path, stream, workspace, Run."""
