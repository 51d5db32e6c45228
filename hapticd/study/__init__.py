"""What accuracy costs, which effects a question needs, and single runs of a scene.

accuracy    error against seconds, for every way of running a scene
effects     which effects of a device change the answer to a question
scene       run a scene, explain its model, compare ways of integrating it
"""
