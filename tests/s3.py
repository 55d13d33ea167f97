"""A server that speaks S3 on loopback (moto), for this process and the workers that it starts."""

import contextlib
import logging
import os

from moto.server import ThreadedMotoServer

BUCKET = "bucket"


@contextlib.contextmanager
def server(monkeypatch):
    """Gives the file system of fsspec, with an empty bucket."""
    import s3fs

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    moto = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    moto.start()
    host, port = moto.get_host_and_port()
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1",
        "NO_PROXY": "127.0.0.1", "no_proxy": "127.0.0.1",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    store = s3fs.S3FileSystem()
    store.mkdir(BUCKET)
    try:
        yield store
    finally:
        moto.stop()
        s3fs.S3FileSystem.clear_instance_cache()
