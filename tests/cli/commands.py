"""Command lines with placeholders for the folders of input {i} and output {o}, and a function that runs them."""

import json
from pathlib import Path

from regtorch.cli import main

SIZE = "--rows 100 --columns 80 --pixel-mm 3.5"
REGISTER = "register {i}/ct.nii.gz {i}/good/radiograph.tiff --view PA --out {o}/new/deep"
SIMULATE = f"simulate {{i}}/ct.nii.gz --view PA --out {{o}}/new {SIZE}"
EVALUATE = "evaluate {i}/good/result.json"
PARAMETERS = ["x_s_mm", "y_s_mm", "z_s_mm", "x_obj_mm", "y_obj_mm", "z_obj_mm", "eta_deg", "theta_deg", "phi_deg"]
SHARED = {"parameters", "view", "mirrored", "detector", "pixel_from_patient"}


def run(arguments: str) -> int:
    try:
        return main(arguments.split())
    except SystemExit as error:
        return int(error.code or 0)


def disk(*folders: Path) -> dict[str, bytes | None]:
    return {str(p): p.read_bytes() if p.is_file() else None for folder in folders for p in folder.rglob("*")}


def result_of(truth: Path) -> dict:
    content = json.loads(truth.read_text())
    del content["targets_patient_mm"]
    return content | {"status": "ok", "message": "", "similarity": 0.5, "evaluations": 1, "seconds": 1, "device": "cpu"}
