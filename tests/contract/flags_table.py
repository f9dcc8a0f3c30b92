"""usage: flags_table.py ROOT DELTARAYD
Checks that server/README.md has each flag of the server, with its default, and no other; and that variables are named as
it says.
"""

import re
import sys

from server_flags import Findings, bytes_of, read, server_flags


def table(readme):
    """Defaults by flag, of rows `--a`, `--b` | 1, 2 | ...; "off" is none."""
    rows = {}
    for names, defaults in re.findall(r"^\| (`--[^|]*) \|([^|]*)\|", readme, re.MULTILINE):
        flags = re.findall(r"`--([a-z-]+)`", names)
        values = [value.strip().strip("`") for value in defaults.split(",")] if defaults.strip() else [""] * len(flags)
        assert len(flags) == len(values), f"a row of {len(flags)} flags and {len(values)} defaults: {names}"
        for flag, value in zip(flags, values):
            assert flag not in rows, f"--{flag} is in the table twice"
            rows[flag] = None if value in ("", "off") else value
    return rows


def same(told, printed):
    return told == printed or (told is not None and printed is not None and bytes_of(told) == bytes_of(printed) is not None)


def main():
    root, program = sys.argv[1:]
    flags = server_flags(program)
    rows = table(read(root, "server", "README.md"))
    findings = Findings()
    for name, flag in flags.items():
        findings.check(name in rows, f"server/README.md lacks --{name}")
        told = rows.get(name)
        findings.check(name not in rows or same(told, flag.default),
                       f"--{name}: server/README.md has the default {told}, the server {flag.default}")
        findings.check(flag.variable == "DELTARAY_" + name.upper().replace("-", "_"),
                       f"--{name} has the variable {flag.variable}")
    for name in rows:
        findings.check(name in flags, f"server/README.md has --{name}, which the server does not know")
    findings.end(f"{len(flags)} flags, all of them documented with their defaults")


main()
