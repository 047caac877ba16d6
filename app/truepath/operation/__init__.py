"""What is asked about an installation rather than a machine: is all here in order?

`doctor` lists findings of the computer, the storage, the service and the devices, each
with what to do about it. It changes nothing and moves nothing. Beside it: backup and
restore, support bundle, unit for systemd. Not here: commands and routes that call these
(`cli.service`, `service.api`), the condition of a machine (`machines.conditions`).
"""
