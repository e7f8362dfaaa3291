"""Wrong settings end in one line that names the key, before any work and before anything is written."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig

from experiments.simulation.checks import CheckFirst, check
from regtorch.errors import RegtorchError

ROOT = Path(__file__).parents[3]
STUDIES = sorted(path.stem for path in (ROOT / "conf" / "study").glob("*.yaml"))


@pytest.mark.parametrize(
    ("wrong", "key"),
    [
        ("dof=5", "dof=5"),
        ("arm=a/b", "arm"),
        ("arm=6", "arm"),
        ("views=[PA,XX]", "views"),
        ("views=[PA,PA]", "views"),
        ("views=[]", "views"),
        ("shard=8/8", "shard=8/8"),
        ("shard=a", "shard"),
        ("threshold_hu=bone", "threshold_hu=bone"),
        ("threshold_hu=90000", "threshold_hu"),
        ("detector.rows=3", "detector.rows=3"),
        ("detector.pixel_mm=0", "detector.pixel_mm"),
        ("seeds=0", "seeds"),
        ("seeds=1.5", "seeds"),
        ("first_seed=-1", "first_seed"),
        ("threads=0", "threads"),
        ("device=gpu", "device=gpu: expected cpu, cuda"),
        ("searched_deviations=wide", "searched_deviations"),
        ("default.source_mm=[0,1000]", "default.source_mm"),
        ("deviations.patient_mm=[1,2,-3]", "deviations.patient_mm"),
        ("radiograph.photons=0", "radiograph.photons"),
        ("similarity=normalized_cross_correlation", "similarity"),
        ("+registration.pses=3", "registration: got an unexpected keyword argument 'pses'"),
        ("+registration.settings.dampng=3", "registration: .*got an unexpected keyword argument 'dampng'"),
        ("registration.settings.poses=many", "registration"),
        ("registration.settings.edges_px=[a]", "registration"),
        ("coordinates=polar", "coordinates=polar: expected patient or detector"),
        ("data.spacing_mm=coarse", "data.spacing_mm=coarse: expected float"),
        ("radiograph.threshold_hu=bone", r"radiograph.threshold_hu=bone: expected float \| None"),
        ("out=null", "out=None: expected a folder"),
    ],
)
def test_a_wrong_setting_is_named(settings, wrong, key):
    with pytest.raises(RegtorchError, match=rf"^{key}"):
        check(settings(wrong))


def test_a_component_that_is_no_function_is_named(settings, tmp_path):
    config = settings(f"out={tmp_path}")
    config.registration = {"settings": {"poses": 60}}
    with pytest.raises(RegtorchError, match=r"^registration: no function, expected _target_"):
        check(config)


def test_a_component_may_have_no_options(settings, tmp_path):
    config = settings(f"out={tmp_path}")
    config.registration = {"_target_": "regtorch.registration.hybrid", "_partial_": True}
    check(config)
    config.similarity = {"_target_": "regtorch.similarity.normalized_cross_correlation", "_partial_": True}
    with pytest.raises(RegtorchError, match=r"expects gradient_correlation; give registration=cmaes"):
        check(config)


def test_any_radiograph_may_be_chosen(settings, tmp_path):
    assert settings().radiograph.threshold_hu == 100
    assert settings("radiograph.threshold_hu=50").radiograph.threshold_hu == 50
    for radiograph in ("simulate", "realistic"):
        check(settings(f"radiograph={radiograph}", f"out={tmp_path}"))


def test_files_are_looked_for(settings, tmp_path):
    with pytest.raises(RegtorchError, match=r"^data\.path: nothing given, expected a value"):
        check(settings("data=ct"))
    with pytest.raises(RegtorchError, match=r"^data\.path=.*none: expected a file"):
        check(settings("data=ct", f"data.path={tmp_path / 'none'}"))
    with pytest.raises(RegtorchError, match=r"^data\.targets=.*none: expected a file"):
        check(settings("data=ct", f"data.path={tmp_path}", f"data.targets={tmp_path / 'none'}"))


@pytest.mark.parametrize(
    ("wrong", "code", "named"),
    [
        (["dof=5"], 2, "error: dof=5: expected 9, 7 or 6"),
        (["-m", "dof=9,5"], 2, "error: dof=5: expected 9, 7 or 6"),
        (["-m", "shard=0/2,0/2"], 2, "error: arm=9-DOF, shard=0/2: two jobs"),
        (["registration.settings.poses=abc"], 2, "error: registration.settings.poses=abc: expected int"),
        (["data.spacing_mm=0.1"], 2, "error: phantom: spacing of 0.1 mm"),
        (["registration.settings.pses=3"], 1, "Key 'pses' is not in struct"),
        (["study=none"], 1, "Could not find 'study/none'"),
    ],
)
def test_nothing_is_written_by_a_job_that_cannot_be(run, tmp_path, wrong, code, named):
    out = tmp_path / "out"
    done = run(*wrong, f"out={out}")
    assert done.returncode == code
    assert named in done.stderr
    assert code == 1 or len(done.stderr.splitlines()) == 1
    assert not out.exists()


def test_a_sweep_whose_last_arm_does_not_mix_is_refused_before_its_first_job(run, tmp_path):
    folder = tmp_path / "9-DOF"
    folder.mkdir()
    (folder / "settings.yaml").write_text("dof: 6\n")
    done = run("-m", "dof=6,9", f"out={tmp_path}")
    assert (done.returncode, list(tmp_path.iterdir())) == (2, [folder])
    assert "9-DOF: made with another" in done.stderr


@pytest.mark.parametrize("study", STUDIES)
def test_every_study_has_settings_that_work(study):
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        config = compose("simulation_study", [f"study={study}"], return_hydra_config=True)
        try:
            CheckFirst().on_multirun_start(config)
        finally:
            HydraConfig.instance().cfg = None


def test_settings_that_refer_to_what_is_not_there_end_in_one_line(capsys):
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        config = compose("simulation_study", ["study=levels", "registration.pixels=[64]"], return_hydra_config=True)
        try:
            with pytest.raises(SystemExit):
                CheckFirst().on_run_start(config)
        finally:
            HydraConfig.instance().cfg = None
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("simulation_study: error: ")
    assert "registration.pixels" in line
