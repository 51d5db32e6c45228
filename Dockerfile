# hapticd on its simulated board, with the operators' page: for computers without Linux.
#
#   docker build --tag hapticd .
#   docker run --rm --publish 127.0.0.1:9873:9874 hapticd
#
# Then open http://127.0.0.1:9873. The page answers to programs of its own account alone, at
# 127.0.0.1; socat, which runs as that account, passes on what comes to port 9874. Publish that port
# to 127.0.0.1 only. A board needs real-time rights and USB, which this image does not ask for.
FROM python:3.13-slim

RUN apt-get update \
    && apt-get install --yes --no-install-recommends socat \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home hapticd

WORKDIR /src
COPY pyproject.toml hatch_build.py constraints.txt README.md LICENSE ./
COPY hapticd ./hapticd
COPY config ./config
COPY firmware_iface ./firmware_iface
COPY systemd ./systemd
RUN pip install --no-cache-dir --constraint constraints.txt .

USER hapticd
WORKDIR /home/hapticd
EXPOSE 9874
CMD ["sh", "-c", "socat TCP-LISTEN:9874,fork,reuseaddr TCP:127.0.0.1:9873 & exec hapticd run"]
