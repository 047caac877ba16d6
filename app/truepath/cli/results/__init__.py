"""Commands that make something else of a result: compare, export, certificate.

Not here: formats of controls (`compensation.formats`), predictions (`cli.analyse`).
"""
