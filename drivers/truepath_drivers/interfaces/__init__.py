"""The service's view of a device: abstract verbs, frozen records, error families.

Verbs are few, synchronous and bounded in time. `stop`, `hold` and `abort` are
idempotent and may be called from any thread in any state; `close` stops first.
"""
