"""Writes the constants of comedi.h as a Python module: `constants.py MODULE`.

pycomedi takes them from the SWIG module of comedilib, which Debian builds for its own Python only. Left out are the
`CMDF_ROUND_*`, whose equal values the lists of pycomedi refuse.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

INCLUDE = "#include <comedilib.h>\n"
NAME = r"((?:CR|AREF|INSN|TRIG|CMDF(?!_ROUND)|SDF|COMEDI|UNIT|RF)_\w+)"
DEFINITION = re.compile(rf"^#define {NAME}[ \t]+\S|^\s*{NAME}\s*(?:=[^,}}]*)?[,}}]?$", re.MULTILINE)


def compiled(*arguments: str, source: str) -> str:
    """What the C compiler prints for a source."""
    command = ["cc", *arguments, "-x", "c", "-"]
    return subprocess.run(command, input=source, stdout=subprocess.PIPE, text=True, check=True).stdout


names = dict.fromkeys(a or b for a, b in DEFINITION.findall(compiled("-E", "-dD", source=INCLUDE)))
lines = "".join(f'printf("{name} = %u\\n", (unsigned int)({name}));\n' for name in names)
with tempfile.TemporaryDirectory() as folder:
    program = Path(folder) / "constants"
    compiled("-o", str(program), source=f"#include <stdio.h>\n{INCLUDE}int main(void) {{ {lines} return 0; }}\n")
    with Path(sys.argv[1]).open("w", encoding="ascii") as module:
        subprocess.run([program], stdout=module, check=True)
