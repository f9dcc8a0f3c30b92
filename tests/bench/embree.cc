#include "tests/bench/embree.h"

#include <embree3/rtcore.h>
#include <xmmintrin.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>
#include <type_traits>

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Counts the memory of a device. An RTCMemoryMonitorFunction; called from all building threads.
bool CountBytes(void* counter, ssize_t bytes, bool) {
  *static_cast<std::atomic<int64_t>*>(counter) += bytes;
  return true;
}

// As Embree's manual recommends for each thread that traces: subnormal numbers are zero while it lives.
class SubnormalsAreZero {
 public:
  SubnormalsAreZero() { _mm_setcsr(before_ | kFlushToZero | kDenormalsAreZero); }
  ~SubnormalsAreZero() { _mm_setcsr(before_); }
  SubnormalsAreZero(const SubnormalsAreZero&) = delete;
  SubnormalsAreZero& operator=(const SubnormalsAreZero&) = delete;

 private:
  static constexpr unsigned kFlushToZero = 0x8000, kDenormalsAreZero = 0x40;
  const unsigned before_ = _mm_getcsr();
};

RTCIntersectContext MakeContext(bool coherent) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  return context;
}

// What a ray that was asked hits. Embree marks an occluded ray by tfar = -infinity.
Hit Answer(Question question, float tfar, unsigned geometry, unsigned primitive, float u, float v) {
  if (question == Question::kAnyHit) return tfar < 0 ? Hit{.t = 0} : Hit{};
  return geometry == RTC_INVALID_GEOMETRY_ID ? Hit{} : Hit{.t = tfar, .u = u, .v = v, .primitive = primitive};
}

// Rays one by one in memory: rtcIntersect1 and rtcIntersect1M.
class SingleWorker final : public Kernel::Worker {
 public:
  enum class Call { kOne, kStream, kCoherentStream };

  SingleWorker(RTCScene scene, Call call, Question question) : scene_(scene), call_(call), question_(question) {}

  void Load(std::span<const Ray> rays) override {
    rays_.resize(rays.size());
    for (size_t i = 0; i < rays.size(); ++i) {
      const Ray& from = rays[i];
      RTCRayHit& to = rays_[i];
      to.ray = {from.origin.x,
                from.origin.y,
                from.origin.z,
                from.t_min,
                from.direction.x,
                from.direction.y,
                from.direction.z,
                0,
                from.t_max,
                0xFFFFFFFF,
                0,
                0};
      to.hit.geomID = to.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    }
  }

  void Trace() override {
    const SubnormalsAreZero subnormals_are_zero;
    RTCIntersectContext context = MakeContext(call_ == Call::kCoherentStream);
    const auto count = static_cast<unsigned>(rays_.size());
    if (question_ == Question::kAnyHit) {
      if (call_ != Call::kOne) {
        rtcOccluded1M(scene_, &context, &rays_.data()->ray, count, sizeof(RTCRayHit));
      } else {
        for (RTCRayHit& ray : rays_) rtcOccluded1(scene_, &context, &ray.ray);
      }
    } else if (call_ != Call::kOne) {
      rtcIntersect1M(scene_, &context, rays_.data(), count, sizeof(RTCRayHit));
    } else {
      for (RTCRayHit& ray : rays_) rtcIntersect1(scene_, &context, &ray);
    }
  }

  void Store(std::span<Hit> hits) const override {
    for (size_t i = 0; i < hits.size(); ++i) {
      const auto& [ray, hit] = rays_[i];
      hits[i] = Answer(question_, ray.tfar, hit.geomID, hit.primID, hit.u, hit.v);
    }
  }

 private:
  const RTCScene scene_;
  const Call call_;
  const Question question_;
  std::vector<RTCRayHit> rays_;
};

// Rays in packets of kWidth, columns in memory: rtcIntersect8 and rtcIntersect16.
template <typename RayHit, size_t kWidth>
class PacketWorker final : public Kernel::Worker {
 public:
  PacketWorker(RTCScene scene, Question question) : scene_(scene), question_(question) {}

  void Load(std::span<const Ray> rays) override {
    packets_.resize((rays.size() + kWidth - 1) / kWidth);
    // The lanes past the last ray look for nothing: tnear > tfar.
    for (size_t i = 0; i < packets_.size() * kWidth; ++i) {
      const Ray& from = rays[std::min(i, rays.size() - 1)];
      RayHit& to = packets_[i / kWidth];
      const size_t lane = i % kWidth;
      to.ray.org_x[lane] = from.origin.x;
      to.ray.org_y[lane] = from.origin.y;
      to.ray.org_z[lane] = from.origin.z;
      to.ray.dir_x[lane] = from.direction.x;
      to.ray.dir_y[lane] = from.direction.y;
      to.ray.dir_z[lane] = from.direction.z;
      to.ray.tnear[lane] = from.t_min;
      to.ray.tfar[lane] = i < rays.size() ? from.t_max : -kInfinity;
      to.ray.time[lane] = 0;
      to.ray.mask[lane] = 0xFFFFFFFF;
      to.ray.id[lane] = 0;
      to.ray.flags[lane] = 0;
      to.hit.geomID[lane] = to.hit.instID[0][lane] = RTC_INVALID_GEOMETRY_ID;
    }
  }

  void Trace() override {
    const SubnormalsAreZero subnormals_are_zero;
    RTCIntersectContext context = MakeContext(true);
    alignas(64) int valid[kWidth];
    std::fill_n(valid, kWidth, -1);
    for (RayHit& packet : packets_) {
      if constexpr (kWidth == 16) {
        if (question_ == Question::kAnyHit) {
          rtcOccluded16(valid, scene_, &context, &packet.ray);
        } else {
          rtcIntersect16(valid, scene_, &context, &packet);
        }
      } else {
        if (question_ == Question::kAnyHit) {
          rtcOccluded8(valid, scene_, &context, &packet.ray);
        } else {
          rtcIntersect8(valid, scene_, &context, &packet);
        }
      }
    }
  }

  void Store(std::span<Hit> hits) const override {
    for (size_t i = 0; i < hits.size(); ++i) {
      const auto& [ray, hit] = packets_[i / kWidth];
      const size_t lane = i % kWidth;
      hits[i] = Answer(question_, ray.tfar[lane], hit.geomID[lane], hit.primID[lane], hit.u[lane], hit.v[lane]);
    }
  }

 private:
  const RTCScene scene_;
  const Question question_;
  std::vector<RayHit> packets_;
};

class EmbreeKernel final : public Kernel {
 public:
  EmbreeKernel(RTCScene scene, std::string_view mode, Question question)
      : scene_(scene), mode_(mode), question_(question) {}

  std::unique_ptr<Worker> MakeWorker(size_t) const override {
    using Call = SingleWorker::Call;
    if (mode_ == "16") return std::make_unique<PacketWorker<RTCRayHit16, 16>>(scene_, question_);
    if (mode_ == "8") return std::make_unique<PacketWorker<RTCRayHit8, 8>>(scene_, question_);
    const Call call = mode_ == "1M" ? Call::kStream : mode_ == "1M_coherent" ? Call::kCoherentStream : Call::kOne;
    return std::make_unique<SingleWorker>(scene_, call, question_);
  }

 private:
  const RTCScene scene_;
  const std::string mode_;
  const Question question_;
};

std::string DeviceConfig(const EmbreeScene::Options& options) {
  std::string config = absl::StrCat("threads=", options.threads);
  if (options.simd_target) {
    const char* const isa = *options.simd_target == SimdTarget::kAvx512 ? "avx512"
                            : *options.simd_target == SimdTarget::kAvx2 ? "avx2"
                                                                        : "sse4.2";
    absl::StrAppend(&config, ",isa=", isa, ",max_isa=", isa);
  }
  return config;
}

class EmbreeSceneImpl final : public EmbreeScene {
 public:
  EmbreeSceneImpl(const TriangleMesh& mesh, const Options& options)
      : device_(rtcNewDevice(DeviceConfig(options).c_str())) {
    if (device_ == nullptr) return;
    rtcSetDeviceMemoryMonitorFunction(device_, CountBytes, &bytes_);
    scene_ = rtcNewScene(device_);
    rtcSetSceneBuildQuality(scene_,
                            options.quality == Quality::kHigh ? RTC_BUILD_QUALITY_HIGH : RTC_BUILD_QUALITY_MEDIUM);
    rtcSetSceneFlags(scene_, options.robust ? RTC_SCENE_FLAG_ROBUST : RTC_SCENE_FLAG_NONE);
    const RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(geometry,
                               options.quality == Quality::kHigh ? RTC_BUILD_QUALITY_HIGH : RTC_BUILD_QUALITY_MEDIUM);
    void* const positions = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                    sizeof(Vec3f), mesh.positions.size());
    void* const indices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                  sizeof(mesh.indices[0]), mesh.indices.size());
    std::memcpy(positions, mesh.positions.data(), mesh.positions.size() * sizeof(Vec3f));
    std::memcpy(indices, mesh.indices.data(), mesh.indices.size() * sizeof(mesh.indices[0]));
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_, geometry);
    rtcReleaseGeometry(geometry);

    const int64_t mesh_bytes = bytes_;
    const PeakMemory memory;
    const Stopwatch stopwatch;
    rtcCommitScene(scene_);
    stopwatch.Stop(&cost_);
    cost_.bytes = static_cast<uint64_t>(bytes_ - mesh_bytes);
    cost_.peak_bytes = memory.bytes();
  }

  ~EmbreeSceneImpl() override {
    if (device_ == nullptr) return;
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }

  absl::Status status() const {
    const RTCError error = rtcGetDeviceError(device_);
    return error == RTC_ERROR_NONE ? absl::OkStatus() : absl::InternalError(absl::StrCat("Embree: error ", error));
  }

  const BuildCost& build_cost() const override { return cost_; }

  std::vector<std::string> modes() const override {
    std::vector<std::string> modes = {"single", "1M", "1M_coherent"};
    if (rtcGetDeviceProperty(device_, RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED) != 0) {
      modes.emplace_back("16");
    } else if (rtcGetDeviceProperty(device_, RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED) != 0) {
      modes.emplace_back("8");
    }
    return modes;
  }

  std::unique_ptr<Kernel> MakeKernel(std::string_view mode, Question question) const override {
    return std::make_unique<EmbreeKernel>(scene_, mode, question);
  }

 private:
  std::atomic<int64_t> bytes_{0};  // outlives the device, which counts what it frees too
  const RTCDevice device_;
  RTCScene scene_ = nullptr;
  BuildCost cost_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<EmbreeScene>> EmbreeScene::Build(const TriangleMesh& mesh, const Options& options) {
  auto scene = std::make_unique<EmbreeSceneImpl>(mesh, options);
  if (absl::Status status = scene->status(); !status.ok()) return status;
  return scene;
}

bool HaveEmbree() { return true; }
std::string EmbreeVersion() { return absl::StrCat("Embree ", RTC_VERSION_STRING); }

}  // namespace deltaray
