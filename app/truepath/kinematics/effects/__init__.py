"""Effects that move the measured point off its nominal, causes of one kind per file.

`base` holds the interface of an effect, `family` that of a family of effects for
discovery, `keys` what distinguishes effects of a family, `conformance` the checks for
every effect. To write one, see docs/write-an-effect.md. Not here: which effects a
machine has (`discovery`), their values (`estimation`).
"""
