"""Where the machine may go: travel, keep-outs, lines of sight."""
