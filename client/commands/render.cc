#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "client/camera.h"
#include "client/commands/commands.h"
#include "client/connection.h"
#include "client/exit_code.h"
#include "client/mesh_key.h"
#include "client/named_option.h"
#include "client/output_file.h"
#include "client/png_image.h"
#include "client/progress_bar.h"
#include "client/query_flags.h"
#include "client/ray_stream.h"
#include "client/shading.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

constexpr uint32_t kMaxSide = 16384;

struct RenderOptions {
  v1::StreamStart start;
  std::string output_path;
  CameraOptions camera;
  Shade shade = Shade::kLambert;
  size_t batch_rays = kDefaultBatchRays;
};

// The rays of a picture, one a pixel, rows from the top.
class CameraRays {
 public:
  CameraRays(const Camera& camera, const CameraOptions& options, v1::RayLayout layout)
      : camera_(camera), options_(options), layout_(layout) {}

  // Fills in the next `limit` rays, fewer at the end; returns false where there are none left.
  bool Next(size_t limit, OutgoingBatch& batch) {
    const uint64_t pixels = uint64_t{options_.width} * options_.height;
    std::string& rays = *batch.rays.mutable_rays();
    for (; batch.ray_count < limit && next_pixel_ < pixels; ++batch.ray_count, ++next_pixel_) {
      const Vec3 direction = camera_.Direction(next_pixel_ % options_.width, next_pixel_ / options_.width);
      if (layout_ == v1::RAY_LAYOUT_FLOAT64X6) {
        Append<double>(direction, rays);
      } else {
        Append<float>(direction, rays);
      }
    }
    return batch.ray_count > 0;
  }

 private:
  template <typename T>
  void Append(const Vec3& direction, std::string& rays) const {
    std::array<T, 6> ray;
    for (int i = 0; i < 3; ++i) {
      ray[i] = static_cast<T>(camera_.eye()[i]);
      ray[i + 3] = static_cast<T>(direction[i]);
    }
    rays.append(reinterpret_cast<const char*>(ray.data()), sizeof(ray));
  }

  const Camera camera_;
  const CameraOptions options_;
  const v1::RayLayout layout_;
  uint64_t next_pixel_ = 0;
};

// A mesh with an origin of its own has coordinates that float32 is too coarse for.
v1::RayLayout LayoutFor(const v1::Mesh& mesh) {
  const v1::Point& origin = mesh.origin();
  const bool at_zero = origin.x() == 0 && origin.y() == 0 && origin.z() == 0;
  return at_zero ? v1::RAY_LAYOUT_FLOAT32X6 : v1::RAY_LAYOUT_FLOAT64X6;
}

// The server would refuse ray 0, which tells nobody what to change.
absl::Status CheckEye(const Vec3& eye, v1::RayLayout layout) {
  constexpr double kMost = std::numeric_limits<float>::max();
  const bool fits = layout == v1::RAY_LAYOUT_FLOAT64X6 ||
                    std::all_of(eye.begin(), eye.end(), [](double x) { return std::abs(x) <= kMost; });
  if (fits) return absl::OkStatus();
  return UsageError(absl::StrFormat("the camera stands at %.6g,%.6g,%.6g, beyond the range of float32; see --eye",
                                    eye[0], eye[1], eye[2]));
}

absl::Status Render(const RenderOptions& options, const Session& session) {
  auto connection = Connection::Open(session);
  if (!connection.ok()) return connection.status();
  v1::GetMeshRequest request;
  request.set_mesh(options.start.mesh());
  v1::GetMeshResponse mesh;
  absl::Status status = connection->CallAgain(request.mesh(), [&](grpc::ClientContext* context) {
    return connection->meshes().GetMesh(context, request, &mesh);
  });
  if (!status.ok()) return status;
  const absl::StatusOr<Camera> camera = Camera::Place(options.camera, mesh.mesh());
  if (!camera.ok()) return camera.status();

  const uint32_t width = options.camera.width;
  const uint32_t height = options.camera.height;
  Shading shading(options.shade, *camera, width, height);
  v1::StreamStart start = options.start;
  // By id, so that a name that moves meanwhile does not bring in another mesh than the one that was framed.
  start.set_mesh(mesh.mesh().id());
  start.mutable_query()->set_layout(LayoutFor(mesh.mesh()));
  if (absl::Status reach = CheckEye(camera->eye(), start.query().layout()); !reach.ok()) return reach;
  for (const v1::HitColumn column : shading.columns()) start.mutable_query()->add_columns(column);

  CameraRays rays(*camera, options.camera, start.query().layout());
  const uint64_t pixels = uint64_t{width} * height;
  uint64_t answered = 0;
  const auto begin = std::chrono::steady_clock::now();
  {
    ProgressBar bar(session.messages, session.show_progress);
    status = StreamBatches(
        *connection, start, [&](OutgoingBatch& batch) { return rays.Next(options.batch_rays, batch); },
        [&](const v1::HitBatch& hits) {
          answered += hits.ray_count();
          bar.Update(static_cast<double>(answered) / pixels, absl::StrCat(GroupDigits(answered), " rays answered"));
          return shading.Add(hits);
        });
  }
  if (!status.ok()) return status;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();

  const absl::StatusOr<std::string> png = EncodePng(shading.Finish());
  if (!png.ok()) return png.status();
  status = IsStandardOutput(options.output_path) ? WriteOutput(session.output, *png)
                                                 : WriteWholeFile(options.output_path, *png);
  if (!status.ok()) return status;
  return WriteOutput(session.messages,
                     absl::StrFormat("%s rays, %s hits, %.3f s, %.2f million rays per second\n", GroupDigits(pixels),
                                     GroupDigits(shading.hit_count()), seconds, pixels / seconds / 1e6),
                     "standard error");
}

// "1,2,3"; throws for CLI11 to report.
Vec3 ParseVec3(const std::string& option, const std::string& text) {
  const std::vector<std::string> parts = absl::StrSplit(text, ',');
  Vec3 vec;
  bool good = parts.size() == 3;
  for (size_t i = 0; good && i < 3; ++i) good = absl::SimpleAtod(parts[i], &vec[i]) && std::isfinite(vec[i]);
  if (!good) throw CLI::ValidationError(option, absl::StrCat("'", text, "' is not three finite numbers x,y,z"));
  return vec;
}

// "640x480".
std::pair<uint32_t, uint32_t> ParseSize(const std::string& text) {
  const std::vector<std::string> parts = absl::StrSplit(text, 'x');
  uint32_t width = 0;
  uint32_t height = 0;
  const bool good = parts.size() == 2 && absl::SimpleAtoi(parts[0], &width) && absl::SimpleAtoi(parts[1], &height);
  if (!good || width < 1 || height < 1 || width > kMaxSide || height > kMaxSide) {
    throw CLI::ValidationError("--size",
                               absl::StrCat("'", text, "' is not WIDTHxHEIGHT with sides of 1 to ", kMaxSide));
  }
  return {width, height};
}

void AddVec3Option(CLI::App& command, const std::string& option, std::function<void(const Vec3&)> set,
                   const std::string& help) {
  command
      .add_option_function<std::string>(
          option, [option, set](const std::string& text) { set(ParseVec3(option, text)); }, help)
      ->type_name("X,Y,Z");
}

void AddCameraFlags(CLI::App& command, CameraOptions& camera) {
  command
      .add_option_function<std::string>(
          "--size", [&camera](const std::string& text) { std::tie(camera.width, camera.height) = ParseSize(text); },
          "Size of the picture in pixels [640x480]")
      ->type_name("WxH");
  AddVec3Option(
      command, "--eye", [&camera](const Vec3& eye) { camera.eye = eye; },
      "Where the camera stands [three quarters, so that all of the mesh is seen]");
  AddVec3Option(
      command, "--target", [&camera](const Vec3& target) { camera.target = target; },
      "Where it looks [the centre of the mesh]");
  AddVec3Option(
      command, "--up", [&camera](const Vec3& up) { camera.up = up; }, "What is up in the picture [0,1,0]");
  command.add_option("--fov", camera.fov_degrees, "Vertical field of view in degrees")
      ->check(CLI::Range(0.01, 179.0))
      ->check(NotNan)
      ->type_name("DEGREES")
      ->capture_default_str();
}

}  // namespace

void AddRenderCommand(CLI::App& app, CommandRun& run) {
  CLI::App& command = *app.add_subcommand("render", "Render a picture of a mesh");
  auto options = std::make_shared<RenderOptions>();
  options->start.mutable_query()->set_kind(v1::QUERY_KIND_CLOSEST_HIT);
  AddMeshArgument(command, [options](const std::string& mesh) { options->start.set_mesh(mesh); });
  command.add_option("-o,--output", options->output_path, "PNG file to write; - for standard output")
      ->required()
      ->check(NoOtherExtension(".png"));
  AddCameraFlags(command, options->camera);
  AddNamedOption<Shade>(
      command, "--shade", {{"lambert", Shade::kLambert}, {"normal", Shade::kNormal}, {"depth", Shade::kDepth}},
      [options](Shade shade) { options->shade = shade; },
      "Matte grey under a light, colours from the normals, or grey by distance [lambert]");
  AddQueryFlags(command, *options->start.mutable_query(), options->batch_rays);
  command.footer(
      "Examples:\n"
      "  deltaray render bunny -o bunny.png\n"
      "  deltaray render bunny -o - --shade normal --size 1920x1080 --wait-final > bunny.png\n"
      "  deltaray render city -o city.png --up 0,0,1 --eye 40,-80,60 --target 0,0,5 --fov 50");
  command.callback([options, &run] { run = [options](const Session& session) { return Render(*options, session); }; });
}

}  // namespace deltaray
