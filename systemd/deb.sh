#!/bin/sh
# Makes a Debian package of the daemon for this processor and the system's Python; `make deb` calls
# it. It holds its dependencies, so that a board needs neither a compiler nor a network. Settings,
# from the environment, beside those of install.sh:
#   OUT         the folder for the package, dist
#   MAINTAINER  name and address for the package's metadata
#   PYTHON      /usr/bin/python3
set -eu
umask 022
cd "$(dirname "$0")/.."

fail() {
    echo "$0: $*" >&2
    exit 1
}

PYTHON=${PYTHON:-/usr/bin/python3}
out=${OUT:-dist}
command -v dpkg-deb > /dev/null || fail "dpkg-deb: not found; build on Debian or Ubuntu"
case $("$PYTHON" -c 'import sys; print(sys.base_prefix)') in
/usr) ;;
*) fail "PYTHON=$PYTHON: is not of this system's packages; name /usr/bin/python3" ;;
esac
minor=$("$PYTHON" -c 'import sys; print(sys.version_info[1])')
# To dpkg only 1.2.0~rc1 comes before 1.2.0
version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' ekf_companion/version.py | sed 's/[abr]/~&/')+py3.$minor
architecture=$(dpkg --print-architecture)

tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
chmod 755 "$tree"
DESTDIR=$tree PREFIX=/opt/ekf-companion LAYOUT=package PYTHON=$PYTHON systemd/install.sh install > /dev/null

doc=$tree/usr/share/doc/ekf-companion
install -D -m 644 LICENSE "$doc/copyright"
gzip -9nc CHANGELOG.md > "$doc/changelog.gz"
gzip -9n "$tree"/usr/share/man/man1/*.1
mkdir "$tree/DEBIAN"
echo /etc/ekf-companion/config.yaml > "$tree/DEBIAN/conffiles"
for script in postinst prerm postrm; do
    install -m 755 "systemd/debian/$script" "$tree/DEBIAN/$script"
done
cat > "$tree/DEBIAN/control" << END
Package: ekf-companion
Version: $version
Architecture: $architecture
Maintainer: ${MAINTAINER:-the maintainers of ekf-companion}
Installed-Size: $(du -sk --exclude=DEBIAN "$tree" | cut -f1)
Depends: python3 (>= 3.$minor), python3 (<< 3.$((minor + 1))), libc6, libstdc++6
Recommends: systemd, udev
Section: misc
Priority: optional
Description: state estimator on MAVLink for a drone's companion computer
 An error-state Kalman filter reads the autopilot's sensors over MAVLink,
 estimates position, velocity, attitude and sensor biases, and sends ODOMETRY
 back. The package holds the daemon with its systemd units and udev rule.
END
mkdir -p "$out"
dpkg-deb --root-owner-group -Zxz -z3 --build "$tree" "$out/ekf-companion_${version}_$architecture.deb"
