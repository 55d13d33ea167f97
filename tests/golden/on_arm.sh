#!/bin/sh
# The golden logs on an emulated ARM processor (R35): `tests/golden/on_arm.sh FOLDER`, by hand: numba
# compiles for half an hour and more there. Nothing is installed but qemu and tools:
#   apt-get install qemu-user-static debootstrap gcc-aarch64-linux-gnu unzip
# An interpreter of Debian's is unpacked into the folder, and the wheels of the lock that exist for ARM;
# autosar-e2e has none, so its own sources are compiled.
set -eu
folder=$(realpath "$1")
repo=$(cd "$(dirname "$0")/../.." && pwd)
pip="$repo/.venv/bin/pip --disable-pip-version-check"
mkdir -p "$folder/wheels" "$folder/site"
cd "$folder"

debootstrap --foreign --arch=arm64 --variant=minbase --include=python3,libpython3.11-stdlib \
    bookworm root >debootstrap.log
for package in root/var/cache/apt/archives/*.deb; do dpkg-deb -x "$package" root; done

python="--python-version 3.11 --implementation cp"
for glibc in 17 24 26 27 28; do python="$python --platform manylinux_2_${glibc}_aarch64"; done
python="$python --platform manylinux2014_aarch64 --platform any"
sed -n 's/^\([a-z0-9.-]*\)[^=]*==\([^ ;\\]*\).*/\1==\2/p' "$repo/requirements.lock" |
    while read -r name; do
        $pip download -q --no-deps --only-binary=:all: $python -d wheels "$name" 2>/dev/null ||
            echo "no wheel: $name"
    done
for wheel in wheels/*.whl; do unzip -qo "$wheel" -d site; done

e2e=$(sed -n 's/^autosar-e2e==\([^ ]*\).*/\1/p' "$repo/requirements.lock")
"$repo/.venv/bin/python" - "$e2e" <<'PYTHON'
import re, sys, urllib.parse, urllib.request

index = "https://pypi.org/simple/autosar-e2e/"
page = urllib.request.urlopen(index).read().decode()
link = next(x for x in re.findall('href="([^"#]+)', page) if x.endswith(f"-{sys.argv[1]}.tar.gz"))
with open("e2e.tar.gz", "wb") as file:
    file.write(urllib.request.urlopen(urllib.parse.urljoin(index, link)).read())
PYTHON
tar xf e2e.tar.gz
source=autosar_e2e-$e2e/src/e2e
headers=$("$repo/.venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
mkdir -p site/e2e
cp "$source"/*.py site/e2e
echo "__version__ = \"$e2e\"" >site/e2e/_version.py
for module in crc p01 p02 p04 p05 p06 p07 p11; do
    aarch64-linux-gnu-gcc -O2 -shared -fPIC -DPy_LIMITED_API=0x030b0000 "-I$headers" "-I$source" \
        -o "site/e2e/$module.abi3.so" "$source/$module.c" "$source/crclib.c" "$source/util.c"
done

cd "$repo"
PYTHONPATH="$repo:$folder/site" PYTHONNOUSERSITE=1 NUMBA_CACHE_DIR="$folder/kernels" \
    exec qemu-aarch64-static -L "$folder/root" "$folder/root/usr/bin/python3.11" \
    -m pytest -p no:xdist -p no:cacheprovider -o timeout=14400 tests/golden/test_golden.py -v
