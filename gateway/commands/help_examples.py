"""At least two examples of each verb, at the end of its `--help`; the tests run them in order."""

from __future__ import annotations

from typing import Final

EXAMPLES: Final = {
    "explain": ("explain 8", "explain TooFewDrives"),
    "dbc": ("dbc -o traction.dbc", "dbc --fd -o traction_fd.dbc"),
    "examples": ("examples -o examples", "examples -o first/try"),
    "completion": ("completion bash", "completion zsh"),
    "demo": ("demo --duration 5", "demo --headless --duration 5 -o demo.png"),
    "sim": ("sim wet_one -o drive.log", "sim healthy -i socketcan -c vcan0 --duration 5"),
    "hil": ("hil release", "hil release silent --junit report.xml --results results",
            "hil --slip-bench leaves -o slip",
            "hil --slip-bench wet degraded --controller creep --expect-score 90"),
    "vcan": ("vcan -- cansend vcan0 123#01",
             "vcan --interfaces can0,can1 --candump bus.log -- cansend can1 123#02"),
    "init": ("init --drives 2 -o first.toml", "init --drives 4 --dbc traction.dbc -o four.toml"),
    "check": ("check train.toml", "check train.toml --no-timing --forecast 3000 -o forecast"),
    "replay": ("replay drive.log -o flags.log",
               "replay drive.log --config train.toml --results results"),
    "shrink": ("shrink drive.log --flag adhesion:2@2.03 -o shrunk",
               "shrink drive.log --flag adhesion:2@5.03 --before 0.2 -o longer"),
    "convert": ("convert drive.log drive.asc", "convert drive.log drive.csv",
                "convert drive.log drive.mcap"),
    "monitor": ("monitor drive.log --web", "monitor -i socketcan -c can0 --web 127.0.0.1:8081"),
    "run": ("run -i socketcan -c can0 --config train.toml",
            "run -i socketcan -c can0 --listen-only --duration 60 --results timing"),
    "keygen": ("keygen -o operator.pem", "keygen --flags -o auth.key"),
    "sign": ("sign train.toml --key operator.pem",
             "sign train.toml --key operator.pem -o train.sig"),
    "verify": ("verify train.toml --public-key operator.pub.pem",
               "verify train.toml --public-key operator.pub.pem --signature train.sig"),
    "calibrate": ("calibrate cool.log warm.log --config train.toml -o limits.toml",
                  "calibrate cool.log -o limits.toml --without-model"),
    "fleet": ("fleet 'logs/**/*.log' -o results",
              "fleet 'logs/**/*.log' -o results --config train.toml -j 2"),
    "fleet-thresholds": ("fleet-thresholds results -o thresholds.toml",
                         "fleet-thresholds results -o thresholds.toml --force"),
    "evaluate": ("evaluate --family single --seeds 0-1 --detector switching -o out",
                 "evaluate thermal --base bench --seeds 0-1 -o out"),
    "reproduce": ("reproduce adhesion -o out", "reproduce thermal -o out --seed 1"),
}  # fmt: skip
"""Examples by verb, without the program's name."""


def examples(verb: str) -> str:
    """End of the `--help` of a verb; empty for a verb without examples."""
    lines = [f"  traction-gateway {one}" for one in EXAMPLES.get(verb, ())]
    return "\n".join(["examples:", *lines]) if lines else ""
