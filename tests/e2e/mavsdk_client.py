"""Run by an interpreter that has MAVSDK: print each ODOMETRY that it receives as a line of JSON.

Usage: python mavsdk_client.py URL SECONDS
"""

import asyncio
import json
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync


async def telemetry(system):
    async for said in TelemetryAsync(system).subscribe_odometry():
        place, q, velocity = said.position_body, said.q, said.velocity_body
        print(
            json.dumps(
                {
                    "via": "telemetry",
                    "time_usec": said.time_usec,
                    "position": [place.x_m, place.y_m, place.z_m],
                    "q": [q.w, q.x, q.y, q.z],
                    "velocity": [velocity.x_m_s, velocity.y_m_s, velocity.z_m_s],
                    "pose_covariance": list(said.pose_covariance.covariance_matrix),
                    "velocity_covariance": list(said.velocity_covariance.covariance_matrix),
                }
            ),
            flush=True,
        )


async def direct(system):
    async for message in MavlinkDirectAsync(system).subscribe_message("ODOMETRY"):
        fields = json.loads(message.fields_json)
        print(
            json.dumps({"via": "direct", "component_id": message.component_id, "fields": fields}),
            flush=True,
        )


async def main(url, seconds):
    role = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(role) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=20.0)
        if system is None:
            sys.exit("no autopilot was found")
        print(json.dumps({"via": "found"}), flush=True)
        tasks = [asyncio.create_task(work(system)) for work in (telemetry, direct)]
        await asyncio.wait(tasks, timeout=seconds)
        for task in tasks:
            if task.done():
                task.result()
            task.cancel()


asyncio.run(main(sys.argv[1], float(sys.argv[2])))
