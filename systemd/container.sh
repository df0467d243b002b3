#!/bin/sh
# Starts the daemon in a container, with the options of `ekf-companion run`. Configuration,
# checkpoint and recordings are in /data, which outlives the container.
set -eu
data=${DATA:-/data}
if [ ! -e "$data/config.yaml" ]; then
    cat > "$data/config.yaml" << END
# \`ekf-companion check-config\` prints every key
link:
  url: tcp:127.0.0.1:5777                 # BlueOS's router of MAVLink

record:
  path: $data/%s.tlog
END
    echo "$data/config.yaml: new; link.url is tcp:127.0.0.1:5777, BlueOS's router of MAVLink" >&2
fi
exec ekf-companion run --config "$data/config.yaml" --checkpoint "$data/checkpoint" "$@"
