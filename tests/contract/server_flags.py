"""What `deltarayd --help` says of its flags, for the rules beside this file."""

import os
import re
import subprocess
import sys


class Flag:
    def __init__(self, default, variable):
        self.default = default  # as printed; None where there is none
        self.variable = variable


def server_flags(program):
    """Flags by their names, without the hyphens before them; those without a variable, as --help, are left out."""
    text = subprocess.run([program, "--help"], check=True, capture_output=True, text=True, timeout=60).stdout
    line = re.compile(r"^  --([a-z-]+)(?: .*?)??(?:=([^=\s]*))? \(Env:(\w+)\)$", re.MULTILINE)
    flags = {name: Flag(default or None, variable) for name, default, variable in line.findall(text)}
    assert len(flags) == text.count("(Env:") > 30, "the help is not read right"
    return flags


def bytes_of(text):
    """A size with a suffix, or a plain number; None where it is neither."""
    match = re.fullmatch(r"(\d+) ?(?:([KMGT])i?B?)?", text, re.IGNORECASE)
    return int(match[1]) << " KMGT".index((match[2] or " ").upper()) * 10 if match else None


class Findings:
    """What is wrong, told at the end."""

    def __init__(self):
        self.count = 0

    def check(self, right, what):
        if not right:
            print(what)
            self.count += 1

    def end(self, summary):
        print(f"{self.count} findings" if self.count else summary)
        sys.exit(self.count > 0)


def read(*parts):
    with open(os.path.join(*parts), encoding="utf-8") as file:
        return file.read()
