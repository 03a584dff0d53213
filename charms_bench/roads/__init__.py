"""highway-env's environments other than the motorway: its roads, seed for seed and bit for bit.

On these roads, vehicles have no common order and no common direction, which is what the engine of
the straight road is fast by: it sorts vehicles by x, keeps tables of neighbours and computes in
loops over all vehicles. Here, each vehicle asks the lanes, one after the other, as in highway-env.
So networks have a small engine of their own, which shares the lanes (`world.road`), the portable
mathematics, the random generator, the constants and the collision test. A vehicle is a row of a
table (`scenes.VEHICLE`), because compiled code passes a row as one pointer.

Lanes, obstacles and default configurations are read from highway-env's own environments.
"""
