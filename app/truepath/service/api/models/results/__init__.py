"""Bodies of results as their files have them; a schema name may hold the module's."""
