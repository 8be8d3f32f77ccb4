"""The options ``--patch`` and ``--group``: a configuration with fitted parameters."""

import argparse

from hilserver.commands.options import config_path, warn
from hilserver.config.patch import Patch, load_patch
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.errors import ConfigError


def assembled(args: argparse.Namespace) -> Assembly:
    """Assemble the requested configuration, with the patch.

    Warn about a patch that was fitted to another configuration.
    """
    _check(args)
    assembly = assemble(config_path(args), args.patch, args.group)
    if assembly.patch is not None:
        warn(assembly.patch.notice(assembly.config.sha256))
    return assembly


def patch_of(args: argparse.Namespace) -> Patch | None:
    """Return the requested patch, if any.

    ConfigError if it cannot be used, or if a group is named without a patch.
    """
    _check(args)
    if args.patch is None:
        return None
    return load_patch(args.patch, args.group)


def _check(args: argparse.Namespace) -> None:
    if args.patch is None and args.group is not None:
        raise ConfigError("--group names a group of a patch: use it with --patch")
