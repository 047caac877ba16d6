"""What moves the measured point off its nominal, causes of one kind in a file.

`base` holds what an effect answers, `catalogue` what a family of effects states so that
discovery can look for it, `keys` what tells effects of a family apart, `conformance`
what every effect keeps. To write one, see docs/write-an-effect.md.
Not here: which effects a machine has (`discovery`), their values (`estimation`).
"""
