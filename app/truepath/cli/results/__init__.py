"""Commands that turn a result into something else: tables, reports, certificates."""
