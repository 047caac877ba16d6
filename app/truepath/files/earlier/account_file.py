"""Files of a certificate other than results: whether their numbers can be stated.

These are files that this project writes, `verification/1` and `compensation/1`; a text
in place of a number in them, or a missing key, would appear on a certificate.
"""

from __future__ import annotations

from pydantic import Field, model_validator

from truepath.documents.file_model import FileModel, require_finite, validate


class _Finite(FileModel):
    @model_validator(mode="before")
    @classmethod
    def _require_finite(cls, content: object) -> object:
        return require_finite(content)


class _Before(FileModel):
    mean: float = Field(ge=0.0)


class _After(_Before):
    mean_uncertainty: float = Field(ge=0.0)


class _Error(FileModel):
    before: _Before
    after: _After


class _Sign(FileModel):
    verified: bool


class _Account(_Finite):
    format: str
    control: str
    carries: str
    not_carried: str
    files: list[str]
    sign: _Sign
    volumetric_error_um: _Error


def require_account(content: object, file: str) -> None:
    """Raise BundleError where the record of compensation files is incomplete."""
    validate(_Account, content, file)


def require_finite_numbers(content: object, file: str) -> None:
    """Raise BundleError where a number of a file is not finite."""
    validate(_Finite, content, file)
