"""`minidual config show`."""

from contextlib import suppress

from minidual.cli.session import Session
from minidual.errors import EnvironmentMissingError, ExitCode


def config_show(*, session: Session) -> ExitCode:
    """Print the resolved configuration as YAML.

    Examples:
        minidual config show --profile smoke
        minidual config show --set plan.queries_n=30 --json
    """
    loaded = session.loaded
    if (
        loaded.config != loaded.reference()
    ):  # a shipped profile needs no check, nor its slow imports
        for entry in session.table.values():
            with suppress(EnvironmentMissingError):  # the machine of the run may have it
                entry.resolved(loaded.config, checked=True)
    document = {
        "profile": loaded.profile,
        "sources": loaded.sources,
        "overrides": [override.text for override in loaded.overrides],
        "config": loaded.config,
    }
    session.finish(document, loaded.to_yaml().splitlines())
    return ExitCode.PASS
