"""Writes conf/registration/hybrid.yaml from the settings of the default search, each with its sentence.

    python -m experiments.settings

A test holds the file and ``regtorch.registration.Settings`` together.
"""

from experiments.common.command import command_parser, tell_written
from experiments.common.defaults import PATH, settings_yaml
from regtorch.files import write_text


def main() -> None:
    command_parser("settings", __doc__).parse_args()
    write_text(PATH, settings_yaml())
    tell_written([PATH])


if __name__ == "__main__":
    main()
