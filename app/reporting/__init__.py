"""An estimate to tables, maps and reports."""
