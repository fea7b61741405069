from isacbench import get_estimator, load_scenario, observe, plot_clouds, score

scenario = load_scenario("street")  # or the path of your own .toml
observation = observe(scenario, snr_db=10, trial=0)  # gated range-Doppler cells of every virtual element
music = get_estimator("music2d", integration="beams")
cloud = music.estimate(observation)  # PointCloud: xyz, velocity, power
scores = score(scenario, cloud, "objects")
print(f"{len(cloud)} points, {scores['objects_detected']:.0%} of the objects")
plot_clouds(scenario.truth, cloud, region=scenario.region, out="picture.png")
