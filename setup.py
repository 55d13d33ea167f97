"""The compiled core, and the packages: `examples/` is in a wheel as `gateway/examples/`.

All else is in `pyproject.toml`.
"""

from setuptools import find_packages, setup

setup(
    packages=[
        *find_packages(include=["dbc*", "estimators*", "gateway*", "sim*"]), "gateway.examples",
    ],
    package_dir={"gateway.examples": "examples"},
    cffi_modules=["core_build.py:builder"],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)  # fmt: skip
