#!/bin/sh
# Installs the daemon, its units and its udev rule, or removes them; `make install` and
# `make uninstall` call it. Settings, from the environment:
#   PREFIX     the daemon's virtual environment, /opt/ekf-companion
#   DESTDIR    a folder that stands for /, to build a package or an image; needs no root
#   CONFIG     the first configuration, if there is none: config/px4.yaml
#   WHEEL      a wheel from `make wheel`; if empty, one is built, which needs gcc
#   EXTRAS     what is installed beside the daemon: report; or none; or others, as in report,plot
#   LOCK       none: dependencies of any version, not those of requirements-*.txt with their hashes
#   LAYOUT     package: units, rule, man page and completions go where a package has them
#   PIP_FLAGS  for a board without a network: --no-index --find-links=FOLDER
#   PYTHON     python3
set -eu
# The service's user must be able to read and run what root installs, whatever root's umask is
umask 022
cd "$(dirname "$0")/.."

root=${DESTDIR:-}
prefix=${PREFIX:-/opt/ekf-companion}
place=$root$prefix
etc=$root/etc/ekf-companion
if [ "${LAYOUT:-}" = package ]; then
    usr=$root/usr units=$root/usr/lib/systemd/system rules=$root/usr/lib/udev/rules.d
else
    usr=$root/usr/local units=$root/etc/systemd/system rules=$root/etc/udev/rules.d
fi
share=$place/share/ekf-companion
extras=${EXTRAS:-report}

fail() {
    echo "$0: $*" >&2
    exit 1
}

# Whether this is a running system, whose systemd and udev must reload
is_live() {
    [ -z "$root" ] && [ -d /run/systemd/system ]
}

# Refuse a folder that is neither empty nor a virtual environment
check() {
    # They go into units, scripts and a sed expression, of which each reads other signs its own way
    case $prefix$root in
    *[!A-Za-z0-9/._+-]*)
        fail "PREFIX=$prefix DESTDIR=$root: use letters, digits and / . _ + - only, no space"
        ;;
    esac
    case $prefix in
    /*) ;;
    *) fail "PREFIX=$prefix: write it from the root, as in /opt/ekf-companion" ;;
    esac
    if [ ! -e "$place/pyvenv.cfg" ] && [ -n "$(ls -A "$place" 2> /dev/null)" ]; then
        fail "PREFIX=$place: holds something else; name a folder of its own"
    fi
}

# Whether the unit's ProtectHome= hides a folder; folders under DESTDIR are for another system
is_hidden() {
    case $1/ in
    /home/* | ~root/* | /run/user/*) ;;
    *) return 1 ;;
    esac
}

check_homes() {
    real=$(readlink -f "$prefix" || echo "$prefix")
    hides="and the service sees nobody's home"
    ! is_hidden "$real" || fail "PREFIX=$prefix: is in $real, $hides; name a folder elsewhere"
    python=${PYTHON:-python3}
    "$place/bin/python" -c '' 2> /dev/null && python=$place/bin/python
    # The environment needs the Python that made it
    home=$("$python" -c 'import os, sys; print(os.path.realpath(sys.base_prefix))')
    is_hidden "$home" || return 0
    words="PYTHON=$python: is in $home, $hides; name one of the system's, as in PYTHON=/usr/bin/python3"
    ! is_live || fail "$words"
    echo "$0: $words" >&2
}

# By the tools of the lock, which pip would else fetch in any version, unseen
build_wheel() {
    wheel="wheel ${PIP_FLAGS:-} --no-deps --wheel-dir $built $built/src"
    if [ "${LOCK:-}" = none ]; then
        $pip $wheel
        return
    fi
    "$place/bin/python" -m venv "$built/tools"
    tools="$built/tools/bin/python -m pip --quiet --disable-pip-version-check"
    $tools install ${PIP_FLAGS:-} --no-compile --require-hashes -r systemd/requirements-build.txt
    $tools $wheel --no-build-isolation
}

install_program() {
    "$place/bin/python" -c '' 2> /dev/null || "${PYTHON:-python3}" -m venv --clear "$place"
    pip="$place/bin/python -m pip --quiet --disable-pip-version-check"
    built=$(mktemp -d)
    trap 'rm -rf "$built"' EXIT
    if [ -z "${WHEEL:-}" ]; then
        # In a copy, so that root leaves no files in the checkout
        mkdir "$built/src"
        cp -R pyproject.toml setup.py README.md LICENSE ekf_companion sim_autopilot systemd "$built/src"
        find "$built/src/ekf_companion" \( -name '*.c' -o -name '*.so' \) -delete
        build_wheel
    else
        [ -f "$WHEEL" ] || fail "WHEEL=$WHEEL: there is no such file; make wheel makes one in dist/"
        cp "$WHEEL" "$built"
    fi
    # Dependencies, as the lock has them
    case ,$extras, in
    *,report,*) lock=requirements-report.txt ;;
    *) lock=requirements-run.txt ;;
    esac
    [ "${LOCK:-}" = none ] ||
        $pip install ${PIP_FLAGS:-} --no-compile --require-hashes -r "systemd/$lock"
    # The same version may have other content; what the lock lacks for other extras follows
    $pip install ${PIP_FLAGS:-} --no-compile --force-reinstall --no-deps "$built"/*.whl
    [ "$extras" = none ] || extra="[$extras]"
    $pip install ${PIP_FLAGS:-} --no-compile "$(echo "$built"/*.whl)${extra:-}"
    # Also for an earlier installation with a stricter umask
    chmod -R a+rX "$place"
    # Compiled now: the service cannot write there. Some packages have files for other versions
    if [ -z "$root" ]; then
        "$place/bin/python" -m compileall -q "$place/lib" > /dev/null || true
    else
        # Programs and scripts contain the path at which they will be
        "$place/bin/python" -m compileall -q -f -s "$root" -p / "$place/lib" > /dev/null || true
        grep -rlIF --exclude-dir=__pycache__ "$place" "$place/bin" "$place/pyvenv.cfg" |
            xargs -r sed -i "s|$place|$prefix|g"
    fi
}

# Man page and completions, by their place below share/
shared() {
    (cd systemd/share && find . -type f)
}

install_files() {
    install -d -m 755 "$etc" "$units" "$rules" "$share/config" "$share/drop-ins" "$usr/bin"
    ln -sfn "$prefix/bin/ekf-companion" "$usr/bin/ekf-companion"
    for file in $(shared); do
        install -D -m 644 "systemd/share/$file" "$usr/share/$file"
    done
    for unit in ekf-companion.service ekf-companion@.service ekf-companion-lidar.service; do
        sed "s|/opt/ekf-companion|$prefix|g" "systemd/$unit" > "$units/$unit"
        chmod 644 "$units/$unit"
    done
    install -m 644 systemd/70-ekf-companion.rules "$rules"
    install -m 644 config/*.yaml "$share/config"
    install -m 644 systemd/drop-ins/*.conf "$share/drop-ins"
    install -m 644 systemd/mavlink-router.conf "$share"
    if [ -e "$etc/config.yaml" ]; then
        echo "$etc/config.yaml: kept as it is"
    else
        install -m 644 "${CONFIG:-config/px4.yaml}" "$etc/config.yaml"
        echo "$etc/config.yaml: new; set link.url in it"
    fi
}

uninstall() {
    if is_live; then
        systemctl stop ekf-companion.service 'ekf-companion@*.service' ekf-companion-lidar.service || true
        systemctl disable ekf-companion.service ekf-companion@.service ekf-companion-lidar.service || true
    fi
    rm -f "$units/ekf-companion.service" "$units/ekf-companion@.service" "$units/ekf-companion-lidar.service"
    rm -f "$rules/70-ekf-companion.rules"
    [ "$(readlink "$usr/bin/ekf-companion")" != "$prefix/bin/ekf-companion" ] ||
        rm -f "$usr/bin/ekf-companion"
    for file in $(shared); do
        rm -f "$usr/share/$file"
    done
    rm -rf "$place"
    echo "Kept, for you to delete: $etc, $root/var/log/ekf-companion*, $root/var/lib/ekf-companion*"
}

check
case ${1:-} in
install)
    [ -n "$root" ] || check_homes
    install_program
    install_files
    ;;
uninstall) uninstall ;;
*) fail "say install or uninstall" ;;
esac
if is_live; then
    systemctl daemon-reload
    if command -v udevadm > /dev/null; then
        udevadm control --reload
        udevadm trigger --subsystem-match=usb --subsystem-match=usb-serial --subsystem-match=tty
    fi
    [ "$1" = uninstall ] || echo "Now: systemctl enable ekf-companion; systemctl restart ekf-companion"
fi
