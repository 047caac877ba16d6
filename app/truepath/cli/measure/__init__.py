"""Commands about machines and devices: `machines`, `drivers`, `formats`.

`machines` uses a running service. Not here: drivers themselves (`truepath_drivers`),
`record` and `demo`, whose parts are one folder up.
"""
