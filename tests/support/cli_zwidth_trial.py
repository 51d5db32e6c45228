"""`hapticd zwidth trial` and `import`: multisines, windows, admittance, live devices, and the text
about a result.
"""

from hapticd.cli.app import main

LINEAR = ["--scene", "theory", "-K", "500", "-B", "1", "-M", "0"]
MULTISINE = ["--excitation", "multisine", "--realisations", "6", "--periods", "1"]


def run(arguments, capsys):
    """(exit code, stdout, stderr)"""
    code = main(["zwidth", *arguments])
    told = capsys.readouterr()
    return code, told.out, told.err
