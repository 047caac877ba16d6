"""State of an installation rather than of a machine: is everything in order?

`doctor` lists findings on the computer, the storage, the service and the devices, each
with a remedy. It changes nothing and moves nothing. In addition: backup and restore,
support bundle, unit for systemd. Not here: commands and routes that call these
(`cli.service`, `service.api`), the condition of a machine (`machines.conditions`).
"""
