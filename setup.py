"""The compiled core; all else is in `pyproject.toml`."""

from setuptools import setup

setup(
    cffi_modules=["core_build.py:builder"],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
