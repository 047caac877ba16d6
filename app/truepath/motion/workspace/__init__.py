"""Where the machine may go: travel, keep-out boxes, lines of sight.

Here: checks of whole swept paths. Not here: `workspace.json` (`files.bundle`).
"""
