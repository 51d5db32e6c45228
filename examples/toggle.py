"""Switch the active damping on and off while a hand holds a stiff spring, and measure the effect on
the motion: the core of the paper, live. Asyncio.
"""

import argparse
import asyncio

import numpy as np
from connect import arguments, connected_aio


async def main(asked: argparse.Namespace, seconds: float = 2.0) -> None:
    """Switch on and off twice."""
    async with (
        connected_aio(asked, "toggle") as device,
        device.lease("environment", at_end="disable"),
        device.lease("perturbation"),
    ):
        noise = np.random.default_rng(1).uniform(-0.1, 0.1, 4000)  # N, one second at 4 kHz
        await device.perturb_load(noise)
        await device.damping("on")
        await device.set(K=200, B=1)
        await device.enable()
        await device.perturb_start(loop=True)
        for value in ("on", "off", "on", "off"):
            receipt = await device.damping(value)
            records, _ = await device.record(seconds)
            level = receipt.effective["active_damping"]
            speed = 1e3 * np.std(records["velocity_m_per_s"])
            margin = receipt.guard.text if receipt.guard else "not judged"
            print(f"damping {level:.2f} N s/m: {speed:.2f} mm/s rms; {margin}")
        await device.disable()


if __name__ == "__main__":
    asyncio.run(main(arguments("Active damping on and off.").parse_args()))
