# The command line in an image: docker build -t bowden . && docker run --rm -v "$PWD:/data" bowden trial -o trial.mcap
FROM python:3.11-slim
ENV NUMBA_CACHE_DIR=/opt/bowden/compiled NUMBA_CPU_NAME=generic
WORKDIR /opt/bowden
COPY . source
RUN pip install --no-cache-dir -c source/constraints.txt './source[parquet,mf4,mat73,xlsx,tdms]'
RUN bowden doctor --compile && chmod -R a+rX compiled
WORKDIR /data
ENTRYPOINT ["bowden"]
