"""What a stored value says of the beam, and line integrals from it.

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
    """Raises ``RegtorchError`` for a word that is none of ``INTENSITIES``."""
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
    warnings = []
    if sign is None and relation not in ("LIN", "LOG"):
        grows = monochrome == "MONOCHROME1"
        if header.get("Modality") in ("RF", "XA"):
            warnings.append(
                f"PixelIntensityRelationship is {relation}: bone is taken to be shown white, as in radiography"
            )
        return Meaning(grows, counts=False, top=top, of_stored=False, warnings=tuple(warnings))
    grows = sign != -1
    if grows != (monochrome == "MONOCHROME1"):
        if for_display and sign is not None:
            warnings.append(f"PixelIntensityRelationshipSign makes {monochrome} show bone black: the sign is believed")
        elif sign is None and header.get("Modality") not in ("RF", "XA"):
            warnings.append(
                f"PixelIntensityRelationship {relation} has no sign: {monochrome} is taken to show bone black"
            )
    counts = relation == "LIN" and not for_display and intensity == "auto"
    if relation == "LIN" and for_display and intensity == "auto":
        warnings.append("LIN but FOR PRESENTATION: taken as processed for a display, so no logarithm (else say counts)")
    return Meaning(grows, counts, top, warnings=tuple(warnings))


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
