"""Settings of the simulation study are checked, for every job of a sweep, before the first job begins."""

import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

from beartype import BeartypeConf
from beartype.door import is_bearable
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import InstantiationException
from hydra.experimental.callback import Callback
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from experiments.common.command import told_in_one_line
from experiments.common.settings import refuse_to_mix
from experiments.common.table import parse_shard, table_name
from regtorch.errors import RegtorchError
from regtorch.files import one_line
from regtorch.geometry import VIEWS
from regtorch.limits import LEAST_PIXELS, MOST_PIXELS
from regtorch.registration import COORDINATES, hybrid
from regtorch.similarity import gradient_correlation

UNSHARED = ("views", "seeds", "first_seed", "shard", "threads", "device", "out")
"""Settings in which rows of one folder may differ."""

COMPONENTS = ("data", "radiograph", "registration", "similarity")

_WHOLE_NUMBERS_ARE_NUMBERS = BeartypeConf(is_pep484_tower=True)

Rule = tuple[Callable[[Any], bool], str]


def _number(low: float, high: float) -> Rule:
    return lambda v: type(v) in (int, float) and low <= v <= high, f"a number from {low:g} to {high:g}"


def _whole(low: int, high: int = 2**32 - 1) -> Rule:
    return lambda v: type(v) is int and low <= v <= high, f"a whole number from {low} to {high}"


def _three(low: float, high: float) -> Rule:
    fits, _ = _number(low, high)
    return lambda v: len(v) == 3 and all(map(fits, v)), f"three numbers from {low:g} to {high:g}"


def _or_null(rule: Rule) -> Rule:
    return lambda v: v is None or rule[0](v), f"{rule[1]}, or null"


_MM = 1e4
_FOLDER = (lambda v: re.fullmatch(r"[\w.+-]*\w[\w.+-]*", v) is not None, "a name for a folder")
_FILE = (lambda v: v is None or Path(v).exists(), "a file that exists")
_RULES: dict[str, Rule] = {
    "dof": (lambda v: v in (9, 7, 6), "9, 7 or 6"),
    "coordinates": (lambda v: v in COORDINATES, " or ".join(COORDINATES)),
    "arm": _FOLDER,
    "out": (lambda v: isinstance(v, str) and v != "", "a folder"),
    "views": (lambda v: 0 < len(v) == len(set(v)) and set(v) <= {*VIEWS}, f"some of {', '.join(VIEWS)}, each once"),
    "threshold_hu": _or_null(_number(-1000, 3000)),
    "seeds": _whole(1),
    "first_seed": _whole(0),
    "threads": _whole(1, 1024),
    "device": (lambda v: re.fullmatch(r"cpu|cuda(:\d+)?", v) is not None, "cpu, cuda or cuda:N"),
    "least_targets": _whole(1),
    "searched_deviations": _number(1e-6, 100),
    "detector.rows": _whole(LEAST_PIXELS, MOST_PIXELS),
    "detector.columns": _whole(LEAST_PIXELS, MOST_PIXELS),
    "detector.pixel_mm": _number(1e-3, 100),
    "default.source_mm": _three(-_MM, _MM),
    "default.patient_mm": _three(-_MM, _MM),
    "default.rotation_deg": _number(-360, 360),
    "deviations.source_mm": _three(0, _MM),
    "deviations.patient_mm": _three(0, _MM),
    "deviations.rotation_deg": _number(0, 90),
    "radiograph.photons": _or_null(_number(1, 1e12)),
    "data.path": _FILE,
    "data.targets": _FILE,
}


class CheckFirst(Callback):
    """Ends in one line and exit code 2 where the settings of any job are wrong, before anything is written."""

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        _all_or_exit(iter([config]))

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        _all_or_exit(_jobs(config))


def _all_or_exit(jobs: Iterator[DictConfig]) -> None:
    tables = set()
    with told_in_one_line("simulation_study"):
        for job in jobs:
            HydraConfig.instance().set_config(job)
            own = OmegaConf.masked_copy(job, [key for key in job if key != "hydra"])
            try:
                OmegaConf.to_container(own, resolve=True)
            except OmegaConfBaseException as error:
                raise RegtorchError(one_line(error)) from None
            check(own)
            table = Path(job.out, job.arm, table_name(job.shard))
            if table in tables:
                raise RegtorchError(f"arm={job.arm}, shard={job.shard}: two jobs of the sweep, expected one for each")
            tables.add(table)


def _jobs(config: DictConfig) -> Iterator[DictConfig]:
    """The jobs that Hydra's basic sweeper makes of a sweep, with its defaults (``hydra.sweeper.params``)."""
    loader = GlobalHydra.instance().config_loader()
    given = [f"{key}={values}" for key, values in (config.hydra.sweeper.params or {}).items()]
    overrides = OverridesParser.create(loader).parse_overrides([*given, *config.hydra.overrides.task])
    for job in BasicSweeper.split_arguments(overrides, max_batch_size=None)[0]:
        yield loader.load_sweep_config(config, job)


def check(config: DictConfig) -> None:
    """Raises ``RegtorchError``, which names the key, for a setting that no job can work with."""
    if missing := sorted(OmegaConf.missing_keys(config)):
        raise RegtorchError(f"{missing[0]}: nothing given, expected a value")
    for key, (fits, expected) in _RULES.items():
        value = OmegaConf.select(config, key)
        try:
            right = fits(value)
        except TypeError:
            right = False
        if not right:
            raise RegtorchError(f"{key}={value}: expected {expected}")
    parse_shard(config.shard)
    made = {key: _checked(config, key) for key in COMPONENTS}
    method = getattr(made["registration"], "func", made["registration"])
    if method is hybrid and made["similarity"] is not gradient_correlation:
        raise RegtorchError(
            "similarity: registration=hybrid expects gradient_correlation; give registration=cmaes to another one, "
            "or study=small_budget, the same with fewer images"
        )
    refuse_to_mix(config, Path(config.out, config.arm), UNSHARED)


def component(config: DictConfig) -> Callable[..., Any]:
    """The function of a component's YAML with its options bound; without options the function itself.

    Methods recognise some similarities by identity. Raises ``TypeError`` for a YAML that makes no function.
    """
    made = instantiate(config, _convert_="all")
    if not isinstance(made, partial):
        raise TypeError("no function, expected _target_ and _partial_: true, or defaults: [NAME] of a file with both")
    return made if made.keywords else made.func


def _checked(config: DictConfig, key: str) -> Callable[..., Any]:
    try:
        made = component(config[key])
    except (InstantiationException, TypeError, ValueError) as error:
        raise RegtorchError(f"{key}: {one_line(error)}") from None
    _check_options(key, made)
    return made


def _check_options(key: str, made: Any) -> None:
    """Checks names and types of the options of a function or dataclass, and of the functions among these options."""
    if isinstance(made, partial):
        call, options = made.func, made.keywords
    elif is_dataclass(made) and not isinstance(made, type):
        call, options = type(made), vars(made)
    else:
        for number, each in enumerate(made if isinstance(made, list | tuple) else ()):
            _check_options(f"{key}.{number}", each)
        return
    try:
        inspect.signature(call).bind_partial(**options)
    except TypeError as error:
        raise RegtorchError(f"{key}: {error}") from None
    kinds = get_type_hints(call)
    for name, value in options.items():
        _check_options(f"{key}.{name}", value)
        some = tuple(value) if isinstance(value, list) else value
        if name in kinds and not is_bearable(some, kinds[name], conf=_WHOLE_NUMBERS_ARE_NUMBERS):
            kind = re.sub(r"[\w.]+\.", "", inspect.formatannotation(kinds[name]))
            example = f", written as in conf/{key.partition('.')[0]}/" if isinstance(value, list) else ""
            raise RegtorchError(f"{key}.{name}={value}: expected {kind}{example}")
