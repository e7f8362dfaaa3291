"""Growth of a process's memory while poses are scored (Linux).

    python -m experiments.memory [ct=FILE] [poses=1000000] [NAME=VALUE ...]

Prints megabytes (10^6 bytes) and seconds.
"""

from omegaconf import OmegaConf

from experiments.benchmark.memory import OPTIONS, measure, options_of
from experiments.common.command import command_parser, told_in_one_line


def main() -> None:
    names = OmegaConf.to_yaml(OmegaConf.create(OPTIONS))
    parser = command_parser("memory", f"{__doc__}\noptions and their defaults, given as NAME=VALUE:\n\n{names}")
    parser.add_argument("options", nargs="*", metavar="NAME=VALUE")
    with told_in_one_line("memory"):
        print(*measure(options_of(parser.parse_args().options)))


if __name__ == "__main__":
    main()
