# craftsim with off-screen rendering (EGL on a GPU, Mesa without one) and its compiled code:
#     docker build -t craftsim .
#     docker run --rm --read-only --tmpfs /tmp -v "$PWD/out:/data/out" craftsim demo --out out/demo
# Any user may run it (--user 1000:1000), and its root may be read-only: what it writes is below /tmp and --out.
FROM python:3.12-slim

RUN apt-get update && apt-get install --yes --no-install-recommends libegl1 libgl1-mesa-dri && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/craftsim
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY craftsim craftsim
COPY scripts scripts
# The wheel holds compiled code, so that no command compiles anew where nothing can be kept.
RUN pip install --no-cache-dir --constraint constraints.txt . 'setuptools>=77' \
    && python scripts/make_wheel.py \
    && pip install --no-cache-dir --no-deps --force-reinstall dist/*.whl \
    && rm -rf /opt/craftsim

# Settings of libraries are kept where any user may write.
ENV HOME=/tmp MPLCONFIGDIR=/tmp/matplotlib PYTHONDONTWRITEBYTECODE=1
WORKDIR /data
USER 65532:65532
ENTRYPOINT ["craftsim"]
CMD ["doctor"]
