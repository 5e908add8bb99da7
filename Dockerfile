# docker build -t minidual .
# docker run --rm -v "$PWD/runs:/minidual/runs" minidual
FROM python:3.12-slim-bookworm
RUN apt-get update \
    && apt-get install -y --no-install-recommends git make libegl1 libgl1-mesa-dri libopengl0 \
    && rm -rf /var/lib/apt/lists/* \
    && git config --system --add safe.directory /minidual
# Another package index than the default: --build-arg PIP_INDEX_URL=... --build-arg UV_DEFAULT_INDEX=...
ARG PIP_INDEX_URL UV_DEFAULT_INDEX
WORKDIR /minidual
COPY . .
# Compiled kernels that any user of the container can read and add to (docker run --user).
ENV NUMBA_CACHE_DIR=/minidual/.kernels PATH=/minidual/.venv/bin:$PATH
RUN make setup && chmod -R a+rwX .kernels runs
CMD ["make", "all"]
