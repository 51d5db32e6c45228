"""SIMULATED in big letters, wherever a person might take the simulated board for a real one."""

SIMULATED = """\
 ████  █  █   █  █   █  █       ███   █████  █████  ████
█      █  ██ ██  █   █  █      █   █    █    █      █   █
 ███   █  █ █ █  █   █  █      █████    █    ████   █   █
    █  █  █   █  █   █  █      █   █    █    █      █   █
████   █  █   █   ███   █████  █   █    █    █████  ████"""
