"""The meaning of stored values for the beam, and line integrals from them.

DICOM PS3.3 C.8.11.3.1.2 (DX) and C.8.7.1 (XA, RF): PixelIntensityRelationship is LIN (proportional to the beam's
intensity), LOG (to its logarithm) or DISP (made for display); PixelIntensityRelationshipSign is 1 where lower values
mean less beam and -1 where higher values do. The relationship speaks of the stored values. PhotometricInterpretation
only says how to show them: MONOCHROME1 shows low values white.

| stated                                    | grows with the beam?        | -log? |
|-------------------------------------------|-----------------------------|-------|
| sign 1 / -1                               | yes / no                    | if LIN, but never when FOR PRESENTATION |
| no sign, LIN or LOG (XA, RF)              | yes                         | if LIN, likewise                        |
| no sign, DISP or nothing (CR, capture)    | MONOCHROME1 yes, 2 no       | no    |

FOR PRESENTATION has been through the maker's processing, which ends in values for a display and not in counts. CR has
none of these attributes: its values are of the same kind, so bone is taken to be shown white.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray
from pydicom import Dataset

from regtorch.errors import RegtorchError
from regtorch.formats.dicom import number

INTENSITIES = ("auto", "line", "counts")


@dataclass(frozen=True)
class Meaning:
    """Whether values grow with the beam, whether they are counts, and from where counts fall that do not grow.

    ``of_stored`` says that this holds of the values as stored and not after RescaleSlope, whose sign turns them.
    """

    grows: bool
    counts: bool
    top: float = 0.0
    of_stored: bool = True
    warnings: tuple[str, ...] = ()


def check_intensity(intensity: str) -> None:
    """Raises ``RegtorchError`` for a word outside ``INTENSITIES``."""
    if intensity not in INTENSITIES:
        raise RegtorchError(f"intensity {intensity!r}: expected one of {', '.join(INTENSITIES)}")


def dicom_meaning(header: Dataset, intensity: str) -> Meaning:
    """The table above for one file; ``line`` and ``counts`` overrule its last column."""
    relation = str(header.get("PixelIntensityRelationship") or "absent").upper()
    stated = number(header, "PixelIntensityRelationshipSign")
    sign = stated if stated in (1, -1) else None
    monochrome = header.PhotometricInterpretation
    for_display = header.get("PresentationIntentType") == "FOR PRESENTATION"
    top = 2 ** (number(header, "BitsStored") or 16) - 1
    if intensity == "counts":
        return Meaning(grows=sign != -1, counts=True, top=top)
    shows = _Shown(relation, monochrome, for_display, fluoroscopy=header.get("Modality") in ("RF", "XA"))
    if sign is None and relation not in ("LIN", "LOG"):
        return shows.by_photometric_interpretation(top)
    return shows.by_sign(sign, top, intensity)


@dataclass(frozen=True)
class _Shown:
    """A file's statements about its grey values, besides a sign."""

    relation: str
    monochrome: str
    for_display: bool
    fluoroscopy: bool

    def by_photometric_interpretation(self, top: float) -> Meaning:
        """Values as a viewer shows them: MONOCHROME1 is dark where they are high."""
        told = f"PixelIntensityRelationship is {self.relation}: bone is taken to be shown white, as in radiography"
        warnings = (told,) if self.fluoroscopy else ()
        return Meaning(self.monochrome == "MONOCHROME1", counts=False, top=top, of_stored=False, warnings=warnings)

    def by_sign(self, sign: float | None, top: float, intensity: str) -> Meaning:
        grows = sign != -1
        warnings = [self._contradiction(sign)] if grows != (self.monochrome == "MONOCHROME1") else []
        linear = self.relation == "LIN" and intensity == "auto"
        if linear and self.for_display:
            warnings.append(
                "LIN but FOR PRESENTATION: taken as processed for a display, so no logarithm (else say counts)"
            )
        return Meaning(grows, linear and not self.for_display, top, warnings=tuple(filter(None, warnings)))

    def _contradiction(self, sign: float | None) -> str:
        """Of sign and photometric interpretation; empty where the file is expected to show bone black."""
        if self.for_display and sign is not None:
            return f"PixelIntensityRelationshipSign makes {self.monochrome} show bone black: the sign is believed"
        if sign is None and not self.fluoroscopy:
            return (
                f"PixelIntensityRelationship {self.relation} has no sign: {self.monochrome} is taken to show bone black"
            )
        return ""


def line_integrals(values: Shaped[ndarray, "h w"], meaning: Meaning) -> Float[ndarray, "h w"]:
    """Bone-bright line integrals up to gain and offset: -log of counts, anything else as it is within 0..1."""
    values = values.astype(np.float32)
    if meaning.counts:
        beam = values if meaning.grows else meaning.top - values
        positive = beam[beam > 0]
        if not positive.size:
            raise RegtorchError("no pixel above 0, expected counts of a beam")
        full = float(np.quantile(positive[:: max(1, positive.size // 100_000)], 0.999))
        # Half the least count stands for none, as a logarithm needs something.
        return -np.log(np.maximum(beam, max(0.5 * float(positive.min()), 1e-6 * full)) / full)
    low, high = float(values.min()), float(values.max())
    span = (high - low) or 1.0
    return (high - values) / span if meaning.grows else (values - low) / span
