"""Rows of other settings never mix."""

import pytest
from omegaconf import OmegaConf

from experiments.common.settings import keep, refuse_to_mix
from regtorch.errors import RegtorchError


def test_a_setting_that_a_folder_has_not_is_another_than_none(tmp_path):
    (tmp_path / "settings.yaml").write_text("seeds: 1\n")
    with pytest.raises(RegtorchError, match="another 'threshold_hu'"):
        refuse_to_mix(OmegaConf.create({"seeds": 1, "threshold_hu": None}), tmp_path, ())


def test_a_function_that_moved_is_the_same_function(tmp_path):
    def settings(target: str) -> OmegaConf:
        return OmegaConf.create({"climb": {"steps": [{"_target_": target, "damping": 1}]}})

    keep(settings("old.place.climb"), tmp_path, ())
    refuse_to_mix(settings("place.climb"), tmp_path, ())
    with pytest.raises(RegtorchError, match="another 'climb'"):
        refuse_to_mix(settings("old.place.descend"), tmp_path, ())
