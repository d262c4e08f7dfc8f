# docker build -t fden_ros . && docker run --rm -it --net=host fden_ros
FROM ros:jazzy
WORKDIR /fden_ros
COPY . .
RUN scripts/install && rm -rf /var/lib/apt/lists/* \
    && sed -i '/^exec/i source /fden_ros/install/local_setup.bash --' /ros_entrypoint.sh
CMD ["bash"]
