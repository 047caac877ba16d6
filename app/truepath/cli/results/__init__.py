"""Commands that convert a result: compare, export, certificate.

Not here: formats of controls (`compensation.formats`), predictions (`cli.analyse`).
"""
