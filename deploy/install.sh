#!/bin/sh
# Installs the clinic on Debian or Ubuntu, or brings it to another version. The Containerfile takes the same steps.
#
#   deploy/install.sh dist/mammometry-*.whl        as root; `make wheel` makes the wheel
set -eu
wheel=$1
here=$(cd "$(dirname "$0")" && pwd)
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends ca-certificates python3-venv >/dev/null
id clinic >/dev/null 2>&1 || useradd --system --create-home --home-dir /var/lib/mammometry --shell /usr/sbin/nologin clinic
install -d -m 700 -o clinic -g clinic /srv/clinic
program=/usr/local/lib/mammometry
python3 -m venv "$program"
"$program/bin/python" -m pip install --quiet --no-cache-dir --upgrade -c "$here/../constraints.txt" "$wheel[clinic,heic]"
ln -sf "$program/bin/mammometry" /usr/local/bin/mammometry
if [ -d /etc/systemd/system ]; then cp "$here"/*.service "$here"/*.timer /etc/systemd/system/; fi
