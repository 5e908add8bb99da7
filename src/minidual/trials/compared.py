"""Methods that a benchmark compares: rows of the table, and policies from elsewhere by a new name."""

import re
from collections.abc import Collection, Iterable

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.trials.methods import ACT, METHODS

NAMED = ACT._replace(summary="policy from elsewhere, from cameras and joints")
"""Of a method that a policy was named for: `--policy NAME=PATH`."""
_POLICY_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


def name_policies(methods: Iterable[str], policies: Collection[str]) -> None:
    """Make a method of each policy whose name is among the compared methods, but not in their table.

    Raises:
        UsageError: A name is no word, or a policy has the name of none of the methods.
    """
    methods = tuple(methods)
    for name in policies:
        if name in METHODS:
            continue
        if not _POLICY_NAME.fullmatch(name):
            raise UsageError(
                f"a policy cannot be named '{name}'; a name is a lower-case word such as my_act",
            )
        if name not in methods:
            named = ",".join((*methods, name))
            raise UsageError(
                f"a policy is named '{name}', and that is none of the methods to compare:"
                f" {', '.join(methods)}",
                remedy=f"--methods {named}",
            )
        METHODS.add(name, NAMED)


def benchmark_methods(config: Config) -> tuple[str, ...]:
    """Return the methods to compare, those of named policies among them.

    Raises:
        UsageError: There is no such method, or see `name_policies`.
    """
    name_policies(config.benchmark.methods, config.benchmark.policies)
    return METHODS.names(config.benchmark.methods)


def benchmark_needs(config: Config) -> tuple[str, ...]:
    """Return the stages that a benchmark needs: those of the policy only if a method drives it.

    Methods with a trainer of their own bring their policy, and so does one whose policy is named.

    Raises:
        UsageError: There is no such method.
    """
    methods = benchmark_methods(config)
    own = [name for name in methods if METHODS[name].learned and METHODS[name].trainer is None]
    if any(name not in config.benchmark.policies for name in own):
        return ("carry", "deploy")
    return ("carry",)
