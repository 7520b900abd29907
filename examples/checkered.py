"""A line of your own: rotors and supports like a chessboard, closer in x than in y, partly worn.

python examples/checkered.py
"""

import gymnasium as gym
import numpy as np
import pygame

import surface_gym as sg

row, column = np.indices((20, 32))
in_line = (row >= 7) & (row < 13)
grip = np.where(column < 16, 0.5, 0.35)  # [-] the far half has seen more parcels

CHECKERED = sg.lines.Pattern(
    rotor=in_line & ((row + column) % 2 == 0),
    lead_in=5,
    pitch=(0.08, 0.1),
    mu_max=grip,
    orientations=tuple(np.radians([-60.0, -30.0, 30.0, 60.0, 90.0])),
)


def main() -> None:
    """Turn all axes to -30 deg for two parcels that enter at 1.5 m/s, and draw the last scene."""
    env = gym.make(
        "SmartSurface/Sort-v0", actions="quadrants", line=CHECKERED, render_mode="rgb_array"
    )
    for parcel in ("S", "B"):
        _, info = env.reset(seed=0, options={"speed": 1.5, "parcel": parcel, "side": 1})
        done = False
        while not done:
            _, _, terminated, truncated, info = env.step([1, 1, 1, 1])
            done = terminated or truncated
        print(f"{parcel}-box: {info['outcome']} after {info['time']:.2f} s")
    picture = np.asarray(env.render()).swapaxes(0, 1)
    pygame.image.save(pygame.surfarray.make_surface(picture), "checkered.png")
    print("drawn in checkered.png")


if __name__ == "__main__":
    main()
