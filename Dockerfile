# The command magical-mj, without OpenGL: pictures are drawn by the software renderer, as two flat views.
#   docker build --tag magical-mj .                                   evaluations, figures, dask (videos: extra video, 165 MB)
#   docker build --tag magical-mj --build-arg EXTRAS=eval,il .        and the learners, with PyTorch; for its index of CPU
#                                                 builds, which are 4 GB smaller: --build-arg PIP_EXTRA_INDEX_URL=...
#   mkdir -p runs     docker would make it as root, who alone could write there; --user is for those who are not number 1000
#   docker run --rm --user "$(id -u)" --volume "$PWD/runs:/home/magical/runs" magical-mj evaluate --policy random --out runs/random
FROM python:3.12-slim

ARG EXTRAS=eval,dask
ARG PIP_EXTRA_INDEX_URL
ENV MAGICAL_MJ_RENDERER=software MUJOCO_GL=off PYTHONUNBUFFERED=1 PIP_NO_CACHE_DIR=1

RUN useradd --create-home --uid 1000 magical
COPY pyproject.toml README.md LICENSE constraints.txt /source/
COPY tools/python_version.py /source/tools/
COPY magical_mj /source/magical_mj
# dm_control, which only `magical_mj.load` needs, is a tenth of what would be installed.
RUN pip install --constraint /source/constraints.txt "/source[${EXTRAS}]" \
    && pip uninstall --yes dm_control labmaze

USER 1000
WORKDIR /home/magical
ENTRYPOINT ["magical-mj"]
CMD ["--help"]
