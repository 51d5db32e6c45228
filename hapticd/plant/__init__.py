"""What the world does between two commands.

effects as values    bodies, friction, electrical, shaped_damping, winding, sensing (all of them: catalogue)
composing            scene -> blueprint and forms -> drive -> compose -> Model; discrete, expm, stability, explain (numpy)
playing              tables -> board.json -> lookup, shape, straight, composed, step (standard library alone)
"""
