"""The options ``--patch`` and ``--group``: a configuration with what a diagnosis has fitted."""

import argparse

from hilserver.commands.options import config_path, warn
from hilserver.config.patch import Patch, load_patch
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.errors import ConfigError


def assembled(args: argparse.Namespace) -> Assembly:
    """Assemble the configuration that was asked for, with the patch.

    A patch that was fitted to another configuration is warned about.
    """
    _check(args)
    assembly = assemble(config_path(args), args.patch, args.group)
    if assembly.patch is not None:
        warn(assembly.patch.notice(assembly.config.sha256))
    return assembly


def patch_of(args: argparse.Namespace) -> Patch | None:
    """Return the patch that was asked for, if any.

    ConfigError if it cannot be used, or a group is named without a patch.
    """
    _check(args)
    return None if args.patch is None else load_patch(args.patch, args.group)


def _check(args: argparse.Namespace) -> None:
    if args.patch is None and args.group is not None:
        raise ConfigError("--group names a group of a patch: use it with --patch")
