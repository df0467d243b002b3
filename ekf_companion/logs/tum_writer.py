"""Writing of estimates as TUM trajectories: ``time x y z qx qy qz qw``, as evo reads them.

Time in seconds, position in metres east, north and up of the origin, the attitude from a body frame
of forward, left, up (ROS REP 103).

Source: Sturm et al. 2012, "A benchmark for the evaluation of RGB-D SLAM systems", file formats.
"""

from __future__ import annotations

from ekf_companion.logs.writer import EstimateWriter, east_north_up, with_position
from ekf_companion.nav.state import Table


class Writer(EstimateWriter):
    """Writes a line for each estimate with a position."""

    def write(self, table: Table) -> None:
        """Append estimates."""
        table = with_position(table)
        pos_enu, q = east_north_up(table)
        seconds, ns = (part.tolist() for part in divmod(table.stamp_ns, 1_000_000_000))
        rows = zip(seconds, ns, *pos_enu.T.tolist(), *q[:, [1, 2, 3, 0]].T.tolist(), strict=True)
        line = "%d.%09d %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n"
        self.file.write("".join([line % row for row in rows]).encode())
